"""Truth of g: how far the boundary colours that a frame is drawn with are from a fit to that very frame."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np

import pvg
from benchmarks.quality.clips import measured_frames, spread, widest
from benchmarks.quality.faces import Floats, Image, View, view_of
from pvg.asset import FaceInFrame
from pvg.curves import CHAIN_RESET_FRAMES, Chain, CurveLabels, labels_by_length, table_labels
from pvg.rendering.placed_face import place_face
from pvg.vectorization.key_colors import fit_key_frame
from pvg.video import read_frames

_CHECKS = 6  # frames of a clip in which g is compared with a fit
_CHAIN_SPACING_PX = 2.0


def _low(data: FaceInFrame, labels: CurveLabels, colors: Floats, view: View) -> Floats:
    """LF = H(g) over the view's window."""
    placed = place_face(data, labels, *view.size)
    if placed is None:
        raise ValueError("the face left the picture")
    rows, columns = view.window
    return placed.membrane(colors).crop(columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start)


def _fit(rgb: Image, view: View) -> Floats:
    placed = view.placed
    if placed is None:
        raise ValueError("the face left the picture")
    colors, _ = fit_key_frame(rgb, view.matte, placed.positions, view.width, 0)
    return colors


def run_truth(clip: Path, asset: Path, frames: int | None = None) -> dict[str, Any]:
    """How far g is from ĝ, the fit to that very frame: mean of |H(g) − H(ĝ)| over the face, some frames of the clip.

    Three ways to carry g: the clip-wide table, the paper's chain from the first key frame, and the same begun anew
    from ĝ every 120 frames.
    """
    cv2.setNumThreads(1)
    with pvg.open_asset(asset, clip) as video:
        face = widest(video)
        seen = measured_frames(video, face, frames)
        numbers = list(seen)
        record = video.records[face]
        size = (video.media.width, video.media.height)
        checked = spread(numbers, _CHECKS)
        tables = [key.colors for key in record.key_frames]
        first = record.blended(tables, numbers[0])
        free, reset = Chain(first, table_labels()), Chain(first, table_labels())
        rows: list[dict[str, float]] = []
        for i, frame in enumerate(f for f in read_frames(clip, start=numbers[0], stop=numbers[-1] + 1)):
            if frame.index not in seen:
                continue
            data = seen[frame.index]
            view = view_of(data, size)
            if view.placed is None:
                continue
            starts = i > 0 and i % CHAIN_RESET_FRAMES == 0
            fitted = _fit(frame.rgb(), view) if starts or frame.index in checked else None
            if starts and fitted is not None:
                reset = Chain(fitted, table_labels())
            labels = labels_by_length(data.landmarks, data.boundary, spacing_px=_CHAIN_SPACING_PX)
            chained, anew = free.step(labels), reset.step(labels)
            if fitted is None or frame.index not in checked:
                continue
            truth = _low(data, table_labels(), fitted, view)
            lows = {
                "table": _low(data, table_labels(), record.blended(tables, frame.index), view),
                "chain": _low(data, labels, chained, view),
                "chain, reset": _low(data, labels, anew, view),
            }
            away = {name: float(np.abs(low - truth)[view.face].mean()) for name, low in lows.items()}
            rows.append({"frame": float(frame.index), **away})
    return {"clip": clip.stem, "rows": rows}
