"""Light that changes: one frame of a clip whose gain goes from 0.4 to 1.0 over 100 frames, and back."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import pvg
from benchmarks.quality.clips import measured_frames, opened_paper, vectorize_clip, widest
from benchmarks.quality.faces import Bools, Floats, Image, View, references_of, view_of
from benchmarks.quality.lossless import at_most, write_lossless
from benchmarks.quality.measures import median_delta_e
from benchmarks.quality.peers import open_methods
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
    return at_most(next(iter(read_frames(clip, start=first, stop=first + 1))).rgb(), _LONGEST_PX)


@dataclass
class _Case:
    """What gathers over the frames of one method and reference, or of the input, over the pixels of the open skin.

    means: (3,) RGB;  delta_e: CIEDE2000 of the median to the reference's;  white: share of the skin.
    """

    means: list[Floats] = field(default_factory=list)
    delta_e: list[float] = field(default_factory=list)
    white: list[float] = field(default_factory=list)

    def add(self, pixels: Image, wanted: Floats | None = None) -> None:
        """Add a frame's skin (n, 3);  wanted: (3,) RGB, that of the reference, None of the input."""
        self.means.append(pixels.mean(axis=0))
        if wanted is not None:
            self.delta_e.append(median_delta_e(pixels, wanted))
            self.white.append(float((pixels.max(axis=1) >= _WHITE).mean()))

    @property
    def step(self) -> float:
        """The largest step from one frame to the next in levels, the mean over the channels."""
        return float(np.abs(np.diff(self.means, axis=0)).mean(axis=1).max())


def run_ramp(clip: Path, asset: Path, references: dict[Path, Path], up: bool, folder: Path) -> list[dict[str, Any]]:
    """A row for every method and reference: skin at white, CIEDE2000 to the reference, steps of the mean skin.

    white: share of the open skin, at most over the frames;  delta_e: of every frame;  step: largest, in levels, from
    one frame to the next, the mean over the channels;  step_in: the input's own.
    """
    cv2.setNumThreads(1)
    ramp = folder / f"ramp-{clip.stem}-{'up' if up else 'down'}.mp4"
    write_lossless(ramp, ramp_frames(_still(clip, asset), up=up))
    own_asset, paper_asset = ramp.with_suffix(".pvg"), ramp.with_suffix(".paper.pvg")
    vectorize_clip(ramp, own_asset, paper=False)
    vectorize_clip(ramp, paper_asset, paper=True)
    source, cases = _Case(), defaultdict[tuple[str, str], _Case](_Case)
    with ExitStack() as stack:
        opened = stack.enter_context(references_of(references))
        video = stack.enter_context(pvg.open_asset(own_asset, ramp))
        face, size = widest(video), (video.media.width, video.media.height)
        seen = measured_frames(video, face)
        first = next(iter(seen))
        paper = opened_paper(stack, paper_asset, ramp, seen[first], first)
        methods = [method for method in open_methods(video, face, paper, opened) if not method.costly]
        brightest = max(seen) if up else min(seen)
        skin = _open_skin(ramp, brightest, view_of(seen[brightest], size))
        for frame in read_frames(ramp):
            if frame.index not in seen:
                continue
            view = view_of(seen[frame.index], size)
            source.add(frame.rgb()[skin])
            for method in methods:
                for reference, picture in zip(opened, method.draw(frame, view), strict=True):
                    wanted = np.median(reference.skin, axis=0)
                    cases[method.name, reference.name].add(picture.rgb[skin], wanted)
    return [
        {
            "clip": clip.stem,
            "up": up,
            "method": method,
            "reference": reference,
            "white": max(case.white),
            "delta_e": [round(value, 2) for value in case.delta_e],
            "step": case.step,
            "step_in": source.step,
        }
        for (method, reference), case in cases.items()
    ]


def _open_skin(ramp: Path, brightest: int, view: View) -> Bools:
    """(H, W) bool, the skin of the face at rest; what is white by itself at full gain is left out."""
    full = next(iter(read_frames(ramp, start=brightest, stop=brightest + 1))).rgb()
    return np.asarray(view.over_picture(view.skin) & (full.max(axis=2) < _HEADROOM))
