"""The colours of a face's parts on its key frame: what a look compares with those of the reference's parts.

Lips that have the skin's colour and are no darker are not lips: a hand covers them. Nor are those that look like what
lies around the mouth, as under a mask of cloth. The mouth is then known by the first frame that shows it.
"""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Floats
from pvg.face import PARTS, Landmarks, add_cover, feather, layout, part_outlines
from pvg.picture import Picture, median_lab
from pvg.raster import Raster, inside, square
from pvg.skin import Matte

_CELLS_A_WIDTH = 128.0
_MARGIN = 0.1  # of the face's width around the landmarks, room for the covers' feather
_COVERED = 0.6  # of a cell that counts
_LEAST_CELLS = 8
_LEAST_SEEN = 0.5  # of a side's cells that the matte shows
_SHADED = 1.5  # a side darker than the other by this is in its shadow and does not count
# of CIELAB beside the skin's: lips that are nearer in chroma and no darker are none
# [measured: 40 lips have 2 to 30 in chroma and -5.5 and less in lightness, a hand before a mouth 0.9 and +5.1]
_LIKE_SKIN, _AS_LIGHT = 5.0, -3.0
# of CIELAB: lips that are nearer to what lies around them are none
# [measured: lips in 500 frames of 15 clips and on 14 portraits are off it by 7.4 to 37, under a hand by 3.4 at least,
# masks of five colours by 0.9 to 3.1]
_AS_AROUND = 3.5
_AROUND = (0.03, 0.09)  # of the face's width from the lips' outline: what lies around them
_LIPS = PARTS.index("lips")


def part_colors(picture: Picture, landmarks: Landmarks, matte: Matte) -> Floats:
    """(P, 3) float32 median colour of each of PARTS, 0-255 RGB, NaN where it is not seen.

    Of two sides that are lit alike the mean counts, else the brighter one. Lips are not seen where they look like what
    is around them.
    """
    width = max(landmarks.axes.width, 1.0)
    step = max(1.0, width / _CELLS_A_WIDTH)
    low = landmarks.stacked.min(axis=0) - _MARGIN * width
    high = landmarks.stacked.max(axis=0) + _MARGIN * width
    rows, columns = (int(np.ceil((high[k] - low[k]) / step)) + 1 for k in (1, 0))
    raster = Raster(np.rint(low).astype(np.float32), step, (rows, columns))
    rgb = picture.cells(raster)
    xs, ys = raster.centers()
    seen = (matte.alpha_at(xs.astype(np.float32), ys.astype(np.float32)) > 0.5) & raster.inside(picture.size)
    origin = float(xs[0]), float(ys[0])
    colors = np.stack([_part_color(part, landmarks, rgb, seen, origin, step) for part in PARTS])
    around = rgb[_around_lips(landmarks, origin, step, seen.shape) & seen].astype(np.float32)
    if not len(around) or not shows_lips(colors) or _apart(colors[_LIPS][None], around) >= _AS_AROUND:
        return colors
    return _without_lips(colors)


def without_covered_lips(parts: Floats, skin: Floats) -> Floats:
    """Colours of parts (P, 3), the lips NaN where they are of the skin's colour;  skin: (n, 3) open skin, 0-255 RGB."""
    if not len(skin) or np.isnan(parts[_LIPS]).any():
        return parts
    lightness, *chroma = median_lab(parts[_LIPS][None]) - median_lab(skin)
    if float(np.hypot(*chroma)) >= _LIKE_SKIN or lightness <= _AS_LIGHT:
        return parts
    return _without_lips(parts)


def shows_lips(parts: Floats) -> bool:
    """Whether the lips of parts (P, 3) are seen."""
    return not bool(np.isnan(parts[_LIPS]).any())


def with_lips_of(parts: Floats, skin: Floats, other: Floats, other_skin: Floats) -> Floats:
    """Parts (P, 3) on their skin (n, 3) with another frame's lips, as they are beside its skin (m, 3)."""
    out = parts.copy()
    light = np.median(skin, axis=0) / np.maximum(np.median(other_skin, axis=0), 1.0)
    out[_LIPS] = np.clip(other[_LIPS] * light, 0.0, 255.0)
    return out


def _without_lips(parts: Floats) -> Floats:
    out = parts.copy()
    out[_LIPS] = np.nan
    return out


def _apart(one: Floats, other: Floats) -> float:
    """How far the medians of two sets of colours (n, 3) and (m, 3) lie apart in CIELAB."""
    return float(np.linalg.norm(median_lab(one) - median_lab(other)))


def _around_lips(landmarks: Landmarks, origin: tuple[float, float], step: float, shape: tuple[int, int]) -> Bools:
    """(h, w) the cells around the lips;  origin, step: as for `_part_color`."""
    outline = (landmarks.points[layout.LIPS_OUTER] - np.array(origin, np.float32)) / np.float32(step)
    lips = inside(outline, shape).view(np.uint8)
    near, far = (cv2.dilate(lips, square(reach * landmarks.axes.width / step)) for reach in _AROUND)
    return np.asarray(far > near)


def _part_color(
    part: str, landmarks: Landmarks, rgb: Bytes, seen: Bools, origin: tuple[float, float], step: float
) -> Floats:
    """(3,) median colour of one part, NaN where it is not seen.

    rgb: (h, w, 3) over the cells of a raster whose first centre is `origin` (x, y) and whose cells are `step` source
    pixels wide;  seen: (h, w), the cells that show the face.
    """
    sides = []
    for outline in part_outlines(part, landmarks):
        cover = np.zeros(seen.shape, np.float32)
        add_cover(cover, [outline], origin, step, feather(part, landmarks))
        within = cover > _COVERED * float(cover.max())
        shown = within & seen
        if shown.sum() >= max(_LEAST_CELLS, _LEAST_SEEN * within.sum()):
            sides.append(np.median(rgb[shown], axis=0))
    if not sides:
        return np.full(3, np.nan, np.float32)
    brightest = max(sides, key=lambda color: float(color.sum()))
    alike = [color for color in sides if _SHADED * color.sum() >= brightest.sum()]
    return np.asarray(np.mean(alike, axis=0), np.float32)
