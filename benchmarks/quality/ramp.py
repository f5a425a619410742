"""Light that changes: one frame of a clip whose gain goes from 0.4 to 1.0 over 100 frames, and back."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import pvg
from benchmarks.quality.clips import measured_frames, opened_paper, vectorize_clip, widest
from benchmarks.quality.faces import Image, references_of, view_of
from benchmarks.quality.measures import median_delta_e
from benchmarks.quality.peers import open_methods
from benchmarks.quality.probes import write_lossless
from pvg.video import read_frames

RAMP_FRAMES = 100
GAINS = (0.4, 1.0)
_WHITE = 250  # the brightest channel from which skin counts as white
_HEADROOM = 240  # skin that is brighter than this at full gain is white by itself and left out
_LONGEST_PX = 720


def ramp_frames(picture: Image, *, up: bool, count: int = RAMP_FRAMES) -> Iterator[Image]:
    """A picture (h, w, 3) under a gain that rises from 0.4 to 1.0, or falls back."""
    for gain in np.linspace(*(GAINS if up else GAINS[::-1]), count):
        yield np.rint(picture * gain).astype(np.uint8)


def _still(clip: Path, asset: Path) -> Image:
    """The first frame with a face, its longest side at most 720 px."""
    with pvg.open_asset(asset, clip) as video:
        first = next(iter(measured_frames(video, widest(video), 1)))
    rgb = next(iter(read_frames(clip, start=first, stop=first + 1))).rgb()
    scale = min(1.0, _LONGEST_PX / max(rgb.shape[:2]))
    side = (round(rgb.shape[1] * scale) // 2 * 2, round(rgb.shape[0] * scale) // 2 * 2)
    return np.asarray(cv2.resize(rgb, side, interpolation=cv2.INTER_AREA), np.uint8)


def run_ramp(clip: Path, asset: Path, references: dict[Path, Path], up: bool, folder: Path) -> list[dict[str, Any]]:
    """A row for every method and reference: skin at white, CIEDE2000 to the reference, steps of the mean skin.

    white: share of the open skin, at most over the frames;  delta_e: of every frame;  step: largest, in levels, from
    one frame to the next, the mean over the channels;  step_in: the input's own.
    """
    cv2.setNumThreads(1)
    ramp = folder / f"ramp-{clip.stem}-{'up' if up else 'down'}.mp4"
    write_lossless(ramp, ramp_frames(_still(clip, asset), up=up))
    assets = ramp.with_suffix(".pvg"), ramp.with_suffix(".paper.pvg")
    for paper, path in enumerate(assets):
        vectorize_clip(ramp, path, paper=bool(paper))
    with ExitStack() as stack:
        opened = stack.enter_context(references_of(references))
        video = stack.enter_context(pvg.open_asset(assets[0], ramp))
        seen = measured_frames(video, widest(video))
        first, brightest = next(iter(seen)), max(seen) if up else min(seen)
        paper_video = opened_paper(stack, assets[1], ramp, seen[first], first)
        methods = [m for m in open_methods(video, widest(video), paper_video, opened) if not m.costly]
        size = (video.media.width, video.media.height)
        where = view_of(seen[brightest], size)
        full = next(iter(read_frames(ramp, start=brightest, stop=brightest + 1))).rgb()
        skin = where.over_picture(where.skin) & (full.max(axis=2) < _HEADROOM)
        means: dict[tuple[str, str], list[np.ndarray]] = {}
        deltas: dict[tuple[str, str], list[float]] = {}
        white: dict[tuple[str, str], list[float]] = {}
        for frame in read_frames(ramp):
            if frame.index not in seen:
                continue
            view = view_of(seen[frame.index], size)
            means.setdefault(("input", ""), []).append(frame.rgb()[skin].mean(axis=0))
            for method in methods:
                for reference, picture in zip(opened, method.draw(frame, view), strict=True):
                    pixels, case = picture.rgb[skin], (method.name, reference.name)
                    means.setdefault(case, []).append(pixels.mean(axis=0))
                    deltas.setdefault(case, []).append(median_delta_e(pixels, np.median(reference.skin, axis=0)))
                    white.setdefault(case, []).append(float((pixels.max(axis=1) >= _WHITE).mean()))
    steps = {case: float(np.abs(np.diff(rows, axis=0)).mean(axis=1).max()) for case, rows in means.items()}
    return [
        {
            "clip": clip.stem,
            "up": up,
            "method": method,
            "reference": reference,
            "white": max(white[method, reference]),
            "delta_e": [round(value, 2) for value in deltas[method, reference]],
            "step": steps[method, reference],
            "step_in": steps["input", ""],
        }
        for method, reference in deltas
    ]
