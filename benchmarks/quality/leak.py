"""Leak: how far a motionless face's colour wanders while a bright panel grows behind it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import pvg
from benchmarks.quality.clips import measured_frames, opened_paper, vectorize_clip
from benchmarks.quality.faces import Floats, Image, references_of, view_of
from benchmarks.quality.lossless import even_side, write_lossless
from benchmarks.quality.masks import widest_landmarks
from benchmarks.quality.measures import wander
from benchmarks.quality.peers import DEEP, open_methods
from pvg.skin import skin_mask
from pvg.video import read_frames, read_image

LEAK_FRAMES = 30
_LEAK_SIDE = 512  # pixels, the longer one
_COSTLY_EVERY = 6  # frames: of so many, costly methods draw the first and the last
_PANEL, _GROUND = np.array([255, 246, 225], np.float32), np.array([70, 72, 78], np.float32)


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


def _person(path: Path, labels: Path | None) -> tuple[Image, Floats]:
    """The portrait and the opacity of its person: by labels, or the skin and what is near it."""
    rgb = read_image(path).rgb()
    if labels is not None:
        known = np.asarray(cv2.imread(str(labels), cv2.IMREAD_UNCHANGED))
        mask = (known > 0).astype(np.float32)
    else:
        landmarks = widest_landmarks(rgb)
        skin = skin_mask(rgb, landmarks).astype(np.uint8)
        size = 2 * round(0.05 * landmarks.axes.width) + 1
        mask = cv2.dilate(skin, np.ones((size, size), np.uint8)).astype(np.float32)
    scale = _LEAK_SIDE / max(rgb.shape[:2])
    side = even_side(rgb, scale)
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
