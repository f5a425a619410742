"""Parts of a face that make-up or blood colours apart from the skin: where they are, as soft covers.

A part ends where it ends: it is a cover of its own, not a value at curves that a membrane carries over the chin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from pvg._arrays import Bytes, Floats
from pvg.face import layout
from pvg.face.landmarks import Landmarks
from pvg.raster import SUBPIXEL_BITS, fixed_point, scaled

PARTS = ("lips", "lids", "cheeks", "brows")
_FEATHER = {"lips": 0.010, "lids": 0.022, "cheeks": 0.075, "brows": 0.014}  # of the face's width [by eye]
_LID_HEIGHT = 0.5  # of the way from the upper lash line to the brow's lower edge
_FINER = 4  # outlines are drawn this many times finer than their cells
_REACH = 3.0  # feathers after which nothing is left of a cover


@dataclass(frozen=True, eq=False)
class Outline:
    """One side of a part.

    polygon: (n, 2) source pixels;  hole: (m, 2) what is not of it, or None.
    """

    polygon: Floats
    hole: Floats | None = None


def part_outlines(part: str, landmarks: Landmarks) -> tuple[Outline, ...]:
    """Where a part of PARTS is on one face, side by side where it has two."""
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
    return tuple(Outline(points[loop]) for loop in (layout.LEFT_BROW, layout.RIGHT_BROW))


def _lid(lashes: Floats, brow: Floats) -> Floats:
    """(n, 2) the lid from the lashes (5, 2) some way to the brow's lower edge (4, 2), both from left to right."""
    over = np.stack([np.interp(np.linspace(0, 3, len(lashes)), np.arange(4), brow[:, axis]) for axis in (0, 1)], axis=1)
    crease = lashes + np.float32(_LID_HEIGHT) * (over - lashes)
    return np.concatenate([lashes, crease[::-1]]).astype(np.float32)


def feather(part: str, landmarks: Landmarks) -> float:
    """Width in source pixels over which a part's cover ends."""
    return _FEATHER[part] * max(landmarks.axes.width, 1.0)


def add_cover(out: Floats, outlines: Sequence[Outline], origin: tuple[float, float], step: float, soft: float) -> None:
    """Add the cover of some outlines to `out` (h, w) float32, in place.

    out: over cells centred at source pixels origin + step·(column, row);  soft: the feather, source pixels. A cell gets
    the share of it that the outline covers, blurred: a part goes as it closes.
    """
    sigma = max(soft / step, 0.5)
    reach = int(np.ceil(_REACH * sigma))
    corner = np.asarray(origin, np.float32)
    for outline in outlines:
        polygon = (outline.polygon - corner) / np.float32(step)
        low = np.floor(polygon.min(axis=0)).astype(int) - reach
        high = np.ceil(polygon.max(axis=0)).astype(int) + reach + 1
        x0, y0, x1, y1 = max(low[0], 0), max(low[1], 0), min(high[0], out.shape[1]), min(high[1], out.shape[0])
        if x0 >= x1 or y0 >= y1:
            continue
        columns, rows = high - low
        finer = np.zeros((rows * _FINER, columns * _FINER), np.uint8)
        shift = low.astype(np.float32)
        _fill(finer, polygon - shift, 255)
        if outline.hole is not None:
            _fill(finer, (outline.hole - corner) / np.float32(step) - shift, 0)
        covered = cv2.resize(finer, (int(columns), int(rows)), interpolation=cv2.INTER_AREA).astype(np.float32)
        side = 2 * reach + 1
        cover = cv2.GaussianBlur(covered, (side, side), sigma, borderType=cv2.BORDER_CONSTANT) / np.float32(255.0)
        out[y0:y1, x0:x1] += cover[y0 - low[1] : y1 - low[1], x0 - low[0] : x1 - low[0]]


def _fill(finer: Bytes, polygon: Floats, level: int) -> None:
    cv2.fillPoly(finer, [fixed_point(scaled(polygon, float(_FINER)))], (level,), shift=SUBPIXEL_BITS)
