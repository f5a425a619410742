"""Measures that need no clip-and-reference pair: leak, truth of the boundary colours, masks against labels."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from numpy.typing import NDArray

import pvg
from benchmarks.quality.clips import measured_frames, opened_paper, vectorize_clip, widest
from benchmarks.quality.faces import Bools, Floats, Image, View, references_of, view_of
from benchmarks.quality.measures import iou, wander
from benchmarks.quality.peers import DEEP, open_methods
from pvg.asset import FaceInFrame
from pvg.curves import CHAIN_RESET_FRAMES, Chain, CurveLabels, labels_by_length, table_labels
from pvg.face import Landmarks
from pvg.landmarks import detect_faces, fit_landmarks
from pvg.rendering.placed_face import place_face
from pvg.skin import SkinTracker, fit_skin_model, skin_mask
from pvg.vectorization.key_colors import fit_key_frame
from pvg.video import read_frames, read_image

LEAK_FRAMES = 30
_LEAK_SIDE = 512
_COSTLY_EVERY = 6
_PANEL, _GROUND = np.array([255, 246, 225], np.float32), np.array([70, 72, 78], np.float32)
_CHECKS = 6  # frames of a clip in which g is compared with a fit
_CHAIN_SPACING_PX = 2.0
# face, ears, neck and the features inside, of the class indices
INSIDE_LABELS = (1, 2, 3, 4, 5, 6, 7, 8, 10, 11, 12, 13, 14)


# --- leak -------------------------------------------------------------------------------------------------------


def leak_frames(portrait: Image, person: Floats, count: int = LEAK_FRAMES) -> Iterator[Image]:
    """A motionless person before a dark wall along which a bright panel grows and brightens: (h, w, 3) frames.

    person: (h, w) opacity of the person in [0, 1].
    """
    columns = np.arange(portrait.shape[1], dtype=np.float32)
    for i in range(count):
        t = i / max(1, count - 1)
        wall = np.where((columns < t * len(columns))[:, None], _GROUND + (0.4 + 0.6 * t) * (_PANEL - _GROUND), _GROUND)
        mixed = person[..., None] * portrait + (1 - person[..., None]) * wall[None]
        yield np.rint(mixed).astype(np.uint8)


def write_lossless(path: Path, frames: Iterator[Image]) -> None:
    """Write RGB frames as a clip that decodes to the very planes it was given."""
    with av.open(str(path), "w") as writer:
        stream = None
        for index, rgb in enumerate(frames):
            if stream is None:
                stream = writer.add_stream("libx264", rate=Fraction(25), options={"qp": "0", "preset": "veryfast"})
                stream.height, stream.width = rgb.shape[:2]
                stream.pix_fmt = "yuv420p"
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(rgb), format="rgb24").reformat(format="yuv420p")
            frame.pts, frame.time_base = index, Fraction(1, 25)
            writer.mux(stream.encode(frame))
        if stream is not None:
            writer.mux(stream.encode(None))


def _person(path: Path, labels: Path | None) -> tuple[Image, Floats]:
    """The portrait and the opacity of its person: by labels, or the skin and what is near it."""
    rgb = read_image(path).rgb()
    if labels is not None:
        known = np.asarray(cv2.imread(str(labels), cv2.IMREAD_UNCHANGED))
        mask = (known > 0).astype(np.float32)
    else:
        landmarks = _landmarks(rgb)
        skin = skin_mask(rgb, landmarks).astype(np.uint8)
        size = 2 * round(0.05 * landmarks.axes.width) + 1
        mask = cv2.dilate(skin, np.ones((size, size), np.uint8)).astype(np.float32)
    scale = _LEAK_SIDE / max(rgb.shape[:2])
    side = (round(rgb.shape[1] * scale) // 2 * 2, round(rgb.shape[0] * scale) // 2 * 2)
    small = cv2.resize(rgb, side, interpolation=cv2.INTER_AREA)
    soft = cv2.resize(cv2.GaussianBlur(mask, (0, 0), 1.0), side, interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.uint8), np.asarray(soft, np.float32)


def run_leak(portrait: Path, labels: Path | None, references: dict[Path, Path], folder: Path) -> list[dict[str, Any]]:
    """The wander of the face's mean colour, a row for every method and reference."""
    cv2.setNumThreads(1)
    clip = folder / f"leak-{portrait.stem}.mp4"
    write_lossless(clip, leak_frames(*_person(portrait, labels)))
    asset, paper_asset = clip.with_suffix(".pvg"), clip.with_suffix(".paper.pvg")
    vectorize_clip(clip, asset, paper=False)
    vectorize_clip(clip, paper_asset, paper=True)
    with ExitStack() as stack:
        opened = stack.enter_context(references_of(references))
        video = stack.enter_context(pvg.open_asset(asset, clip))
        seen = measured_frames(video, 0, LEAK_FRAMES)
        first = next(iter(seen))
        paper = opened_paper(stack, paper_asset, clip, seen[first], first)
        methods = open_methods(video, 0, paper, opened)
        size = (video.media.width, video.media.height)
        fixed = view_of(seen[first], size).inner
        window = view_of(seen[first], size).window
        means: dict[tuple[str, str], list[NDArray[np.float64]]] = {}
        drawn_in: dict[str, list[int]] = {}
        for frame in read_frames(clip):
            view = view_of(seen[frame.index], size)
            means.setdefault(("input", ""), []).append(frame.rgb()[window][fixed].mean(axis=0))
            for method in methods:
                if method.name == DEEP or (method.costly and frame.index % _COSTLY_EVERY not in (0, _COSTLY_EVERY - 1)):
                    continue
                drawn_in.setdefault(method.name, []).append(frame.index)
                for reference, picture in zip(opened, method.draw(frame, view), strict=True):
                    means.setdefault((method.name, reference.name), []).append(picture.rgb[window][fixed].mean(axis=0))
    return [
        {
            "scene": portrait.stem,
            "method": method,
            "reference": reference,
            "leak": wander(np.stack(rows)),
            "curve": [round(float(row.mean()), 3) for row in rows],
            "frames": drawn_in.get(method, list(range(len(rows)))),
        }
        for (method, reference), rows in means.items()
    ]


# --- truth of g -------------------------------------------------------------------------------------------------


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
        checked = {numbers[int(i)] for i in np.rint(np.linspace(0, len(numbers) - 1, min(_CHECKS, len(numbers))))}
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


# --- masks ------------------------------------------------------------------------------------------------------


def _landmarks(rgb: Image) -> Landmarks:
    meshes = [fit_landmarks(rgb, face).points for face in detect_faces(rgb)]
    widest = max(meshes, key=lambda mesh: float(np.ptp(mesh[:, 0])))
    return Landmarks.from_mesh(widest)


def _as_tracked(rgb: Image, landmarks: Landmarks) -> Bools:
    """The mask that a clip of this one frame would get."""
    matte = SkinTracker(fit_skin_model(rgb, landmarks)).step(rgb, landmarks)
    return matte.mask_at(np.arange(rgb.shape[1], dtype=np.float32), np.arange(rgb.shape[0], dtype=np.float32))


def run_masks(labelled: tuple[tuple[Path, Path], ...]) -> list[dict[str, Any]]:
    """IoU of our masks and of the paper's rule with the labelled portraits."""
    rows = []
    for portrait, labels in labelled:
        rgb = read_image(portrait).rgb()
        truth = np.isin(np.asarray(cv2.imread(str(labels), cv2.IMREAD_UNCHANGED)), INSIDE_LABELS)
        landmarks = _landmarks(rgb)
        rows.append(
            {
                "portrait": portrait.stem,
                "landmarks": iou(skin_mask(rgb, landmarks), truth),
                "landmarks, in clips": iou(_as_tracked(rgb, landmarks), truth),
                "ycbcr": iou(skin_mask(rgb, landmarks, method="ycbcr"), truth),
            }
        )
    return rows
