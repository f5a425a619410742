"""Guards: eyes and teeth go their own way, so they are taken out of the matte; their brightness follows the skin's.

White is seen beside what surrounds it: eyes as bright as they were look milky in a face made dark, dull in one made
bright. Within a guard luma is multiplied by a power of the gain in luma of the skin around it, and so is chroma as the
skin darkens,

    Y' = (Y_skin' / Y_skin)^s · Y        c' = min(1, (Y_skin' / Y_skin)^s) · c

which is the clip itself where the skin stays. Chroma never grows: a dark eye in the warm shade of a face has little,
and would turn red when it is made bright. `planes` adds a part of the skin's change of chroma: in warm light white is a
little warm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from pvg._arrays import Floats
from pvg.face import layout, soft_cover
from pvg.membrane import Membrane
from pvg.raster import scaled
from pvg.rendering.placed_face import PlacedFace

_FEATHER = 0.015  # of the face's width [by eye: narrow eyes stay dark, no rim is seen]
_CELLS_A_SPREAD = 2.0  # at least; so the guards of large faces are blurred on cells of several pixels
_AROUND = 0.25  # of the face's width: spread of the weights of the skin that a guard follows [by eye]
_FOLLOWS = 0.8  # s [by eye]
_GAINS = (0.25, 3.0)  # of the skin's luma [by eye]
_LEAST_LUMA = 1.0  # levels of 255 added to both sides of a gain, so that black skin has one


@dataclass(frozen=True, eq=False)
class Guard:
    """What one feature takes out of a face's matte.

    x, y: its first pixel in the face's window, multiples of the chroma step;  weight: (h, w) float32, the alpha that
    is taken out;  around: (n,) float32 how much the samples of curves on open skin count for it, by how near they are.
    """

    x: int
    y: int
    weight: Floats
    around: Floats


def guarded_alpha(
    face: PlacedFace, protect: Sequence[str], skin: Floats | None = None, *, in_place: bool = False, align: int = 2
) -> tuple[Floats, list[Guard]]:
    """The face's matte (h, w) without the features that go their own way ("eyes", "teeth"), and those.

    skin: how far the nodes of the face's lattice show skin in the mouth, see `pvg.rendering.mouth`: it stays;
    in_place: whether the face's own matte may be changed, since nobody needs it again;  align: the chroma step.
    """
    landmarks = face.data.landmarks
    polygons: list[tuple[Floats, Floats | None]] = []
    if "eyes" in protect:
        polygons += [(landmarks.points[eye], None) for eye in (layout.LEFT_EYE, layout.RIGHT_EYE)]
    if "teeth" in protect:
        polygons.append((landmarks.points[layout.LIPS_INNER], skin))
    if not polygons:
        return face.alpha, []
    sigma = max(0.8, _FEATHER * landmarks.axes.width)
    origin = np.array([face.x, face.y], np.float32)
    alpha = face.alpha if in_place else face.alpha.copy()
    guards = []
    for polygon, stays in polygons:
        taken = _take_out(alpha, polygon - origin, sigma, align)
        if taken is None:
            continue
        x, y, weight = taken
        if stays is not None:
            kept = weight * _at_pixels(stays, face, (x, y), weight.shape)
            alpha[y : y + weight.shape[0], x : x + weight.shape[1]] += kept
            weight -= kept
        guards.append(Guard(x, y, weight, _skin_around(polygon, face)))
    return alpha, guards


def _skin_around(polygon: Floats, face: PlacedFace) -> Floats:
    """See `Guard`, for a feature within a polygon of source pixels."""
    spread = _AROUND * max(face.data.landmarks.axes.width, 1.0)
    center = np.asarray(polygon.mean(axis=0), np.float32)
    away = (face.positions[face.labels.on_open_skin] - center) / np.float32(spread)
    return np.asarray(np.exp(-0.5 * (away * away).sum(axis=1)), np.float32)


def _at_pixels(nodes: Floats, face: PlacedFace, corner: tuple[int, int], shape: tuple[int, ...]) -> Floats:
    """What the nodes of a face's lattice say at pixels (h, w) of its window, from its pixel `corner` x, y on."""
    (x, y), (rows, columns) = corner, shape
    xs, ys = face.x + x + np.arange(columns), face.y + y + np.arange(rows)
    return np.asarray(Membrane(face.lattice(), nodes[None]).read(xs, ys)[0], np.float32)


def _take_out(alpha: Floats, polygon: Floats, sigma: float, align: int) -> tuple[int, int, Floats] | None:
    """Fade alpha to 0 inside a polygon of its pixels, over roughly `sigma` at its edge, in place.

    Returns where it was changed, x and y, and what was taken there, (h, w); None outside of the window.
    """
    cell = max(1, int(sigma / _CELLS_A_SPREAD))
    within = (-(-alpha.shape[0] // cell) + 1, -(-alpha.shape[1] // cell) + 1)  # and one that the last are read between
    guard, (column, row) = soft_cover(scaled(polygon, 1.0 / cell), sigma / cell, within)
    if cell > 1 and guard.size:
        size = guard.shape[1] * cell, guard.shape[0] * cell
        guard = np.asarray(cv2.resize(guard, size, interpolation=cv2.INTER_LINEAR), np.float32)
    x0, y0 = column * cell, row * cell
    left, top = max(x0, 0), max(y0, 0)
    right, bottom = min(x0 + guard.shape[1], alpha.shape[1]), min(y0 + guard.shape[0], alpha.shape[0])
    if right <= left or bottom <= top:
        return None
    x, y = left // align * align, top // align * align
    weight = np.zeros((bottom - y, right - x), np.float32)
    part = alpha[top:bottom, left:right]
    taken = weight[top - y :, left - x :]
    np.multiply(part, guard[top - y0 : bottom - y0, left - x0 : right - x0], out=taken)
    part -= taken
    return x, y, weight


def guard_gain(guard: Guard, face: PlacedFace, luma: Floats, new: Floats, level: float = 1.0) -> float:
    """What the colours within a guard are multiplied by: 1 where the skin around it keeps its luma.

    luma, new: (S,) of the boundary colours g and g', codes above black;  level: code values a level of 255.
    """
    skin, weight = face.labels.on_open_skin, guard.around
    least = _LEAST_LUMA * level * float(weight.sum())
    before, after = (max(float((weight * values[skin]).sum()), 0.0) + least for values in (luma, new))
    gain = min(max(after / before, _GAINS[0]), _GAINS[1]) if before > 0.0 else 1.0
    return float(gain**_FOLLOWS)
