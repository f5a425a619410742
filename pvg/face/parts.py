"""Parts of a face that make-up or blood colours apart from the skin: where they are, as soft covers.

A part ends where it ends: it is a cover of its own, not a value at curves that a membrane carries over the chin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pvg._arrays import Floats, ramp
from pvg.face import layout
from pvg.face.cover import soft_cover
from pvg.face.landmarks import Landmarks

PARTS = ("lips", "lids", "cheeks", "brows")
_FEATHER = {"lips": 0.010, "lids": 0.022, "cheeks": 0.075, "brows": 0.014}  # of the face's width [by eye]
_LID_HEIGHT = 0.5  # of the way from the upper lash line to the brow's lower edge
_CLOSED, _OPEN = 0.06, 0.20  # eye aspect ratio [measured, 15 clips and 16 portraits: 0.01 to 0.1, and 0.2 to 0.45]


@dataclass(frozen=True, eq=False)
class Outline:
    """One side of a part.

    polygon: (n, 2) source pixels;  hole: (m, 2) what is not of it, or None.
    """

    polygon: Floats
    hole: Floats | None = None


def part_outlines(part: str, landmarks: Landmarks) -> tuple[Outline, ...]:
    """Where a part is on one face, side by side where it has two. Raises `ValueError` for one that is not of PARTS."""
    points, stacked = landmarks.points, landmarks.stacked
    if part == "lips":
        return (Outline(points[layout.LIPS_OUTER], points[layout.LIPS_INNER]),)
    if part == "lids":
        return tuple(
            Outline(_lid(points[lashes], points[brow]))
            for lashes, brow in (
                (layout.LEFT_UPPER_LASHES, layout.LEFT_LOWER_BROW_EDGE),
                (layout.RIGHT_UPPER_LASHES, layout.RIGHT_LOWER_BROW_EDGE),
            )
        )
    if part == "cheeks":
        return tuple(Outline(stacked[loop]) for loop in (layout.STACKED_LEFT_CHEEK, layout.STACKED_RIGHT_CHEEK))
    if part == "brows":
        return tuple(Outline(points[loop]) for loop in (layout.LEFT_BROW, layout.RIGHT_BROW))
    raise ValueError(f"a face has no part {part!r}; known are {', '.join(PARTS)}")


def taken(part: str, landmarks: Landmarks) -> tuple[float, ...]:
    """How much of a part's change each of its `part_outlines` takes, in [0, 1].

    What is dark of an open eye's lid is the fold over it and the shade of its lashes, spread over the whole lid of a
    closed eye it would be paint: lids take less the more they close, by the eye aspect ratio (Soukupová & Čech 2016).
    """
    if part != "lids":
        return (1.0,) if part == "lips" else (1.0, 1.0)
    eyes = landmarks.points[[layout.LEFT_EYE_CONTOUR, layout.RIGHT_EYE_CONTOUR]]
    first, upper, second, lower = eyes[:, 0], eyes[:, 1:3], eyes[:, 3], eyes[:, 5:3:-1]
    height = np.linalg.norm(upper - lower, axis=-1).mean(axis=1)
    aspect = height / np.maximum(np.linalg.norm(second - first, axis=-1), 1e-6)
    return tuple(ramp(aspect, _CLOSED, _OPEN).tolist())


def _lid(lashes: Floats, brow: Floats) -> Floats:
    """(n, 2) the lid from the lashes (5, 2) some way to the brow's lower edge (4, 2), both from left to right."""
    over = np.stack([np.interp(np.linspace(0, 3, len(lashes)), np.arange(4), brow[:, axis]) for axis in (0, 1)], axis=1)
    crease = lashes + np.float32(_LID_HEIGHT) * (over - lashes)
    return np.concatenate([lashes, crease[::-1]]).astype(np.float32)


def feather(part: str, landmarks: Landmarks) -> float:
    """Width in source pixels over which a part's cover ends."""
    return _FEATHER[part] * max(landmarks.axes.width, 1.0)


def add_cover(
    out: Floats,
    outlines: Sequence[Outline],
    origin: tuple[float, float],
    step: float,
    soft: float,
    shares: Sequence[float] | None = None,
) -> None:
    """Add the cover of some outlines to `out` (h, w) float32, in place.

    out: over cells centred at source pixels origin + step·(column, row);  soft: the feather, source pixels;
    shares: what each outline's cover is multiplied by, 1 when None. A cell gets the share of it that the outline
    covers, blurred.
    """
    sigma = max(soft / step, 0.5)
    corner, cell = np.asarray(origin, np.float32), np.float32(step)
    for outline, share in zip(outlines, shares or (1.0,) * len(outlines), strict=True):
        if share == 0.0:
            continue
        hole = None if outline.hole is None else (outline.hole - corner) / cell
        cover, (x, y) = soft_cover((outline.polygon - corner) / cell, sigma, out.shape, hole)
        x0, y0 = max(x, 0), max(y, 0)
        x1, y1 = min(x + cover.shape[1], out.shape[1]), min(y + cover.shape[0], out.shape[0])
        if x0 < x1 and y0 < y1:
            out[y0:y1, x0:x1] += np.float32(share) * cover[y0 - y : y1 - y, x0 - x : x1 - x]
