"""Which tracks show the same person: tracks end at cuts and losses, persons do not.

Told from the face's proportions and its skin colour. That is far from recognising faces, so only tracks that are alike
in both are linked: a person in two parts costs a little evenness between shots, two persons taken for one would share
a transport.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from pvg._arrays import Doubles, Floats
from pvg.face import layout
from pvg.landmarks.tracks import FaceTrack

_FRONTAL_DEG = (20.0, 30.0)  # yaw, pitch
_LEAST_FRAMES = 5
RATIOS = 11
"""How many lengths a face is told by."""
_SPREAD = np.array((0.021, 0.018, 0.044, 0.040, 0.034, 0.098, 0.039, 0.017, 0.019, 0.023, 0.027), np.float32)
"""How much the logarithms of the proportions differ within a person. [measured: first and last thirds of 20 tracks]"""
_ALIKE = 0.65
"""Rms difference of the proportions in spreads up to which two tracks can be one person. [measured on 20 tracks of 18
persons: different ones differ by 0.82 at least and 3 in the median, the same one in two clips by 0.2 to 0.65]"""
_ALIKE_CHROMA, _ALIKE_LIGHTNESS = 10.0, 25.0  # CIELAB: light differs more between shots than hue does


@dataclass(frozen=True)
class FaceShape:
    """What is remembered of a track to tell persons by.

    first, last: its frames;  proportions: see `proportions_of`.
    """

    first: int
    last: int
    proportions: Floats | None


def frontal_ratios(track: FaceTrack) -> Floats:
    """11 lengths of a face over the distance of its outer eye corners in every frame that shows it from the front.

    Returns (m, 11) float32.
    """
    seen = (track.score > 0) & (np.abs(track.pose[:, :2]) < _FRONTAL_DEG).all(axis=1)
    points = track.landmarks.points[seen].astype(np.float64)
    left = points[:, layout.LEFT_EYE_CONTOUR].mean(axis=1)
    right = points[:, layout.RIGHT_EYE_CONTOUR].mean(axis=1)
    middle, across = (left + right) / 2, right - left
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    down = np.stack([-across[:, 1], across[:, 0]], axis=1)
    shifted = points - middle[:, None]
    # a turned head is narrower by the cosine of its yaw
    x = np.einsum("fpk,fk->fp", shifted, across) / np.cos(np.radians(track.pose[seen, :1]))
    y = np.einsum("fpk,fk->fp", shifted, down)

    def between(a: int, b: int) -> Doubles:
        return np.asarray(np.hypot(x[:, a] - x[:, b], y[:, a] - y[:, b]))

    nose = y[:, layout.NOSE_BASE_MIDDLE]
    lengths = [
        between(*layout.INNER_EYE_CORNERS),
        (between(*layout.LEFT_EYE_CORNERS) + between(*layout.RIGHT_EYE_CORNERS)) / 2,  # eye width
        between(layout.NOSE_BASE[0], layout.NOSE_BASE[-1]),  # nose width
        between(layout.NOSE_RIDGE[0], layout.NOSE_TIP),
        nose - y[:, layout.INNER_EYE_CORNERS].mean(axis=1),  # eyes to nose base
        y[:, layout.UPPER_LIP_TOP] - nose,
        y[:, layout.CHIN] - nose,
        *(between(*ends) for ends in layout.CONTOUR_WIDTHS),
    ]
    return np.asarray(np.stack(lengths, axis=1) / between(*layout.OUTER_EYE_CORNERS)[:, None], np.float32)


def face_proportions(track: FaceTrack | FaceShape) -> Floats | None:
    """Those of a track, see `proportions_of`."""
    return track.proportions if isinstance(track, FaceShape) else proportions_of(frontal_ratios(track))


def proportions_of(ratios: Floats) -> Floats | None:
    """Logarithms of a face's `frontal_ratios` (m, 11), (11,) float32.

    The median over the frames that show it from the front; None when they are too few.
    """
    if len(ratios) < _LEAST_FRAMES:
        return None
    return np.log(np.maximum(np.median(ratios, axis=0), 1e-3)).astype(np.float32)


def link_persons(tracks: Sequence[FaceTrack | FaceShape], skin_rgb: npt.ArrayLike) -> tuple[int, ...]:
    """The person of each track, numbered in the order of the tracks.

    skin_rgb: (n, 3) colour of each track's skin, 0-255. Tracks that overlap in time are never one person, and any two
    tracks of a person are alike.
    """
    farthest = _distances(tracks, np.asarray(skin_rgb, np.float32).reshape(-1, 3))  # of two groups, at their names
    i, j = np.nonzero(np.tril(farthest <= _ALIKE, -1))
    nearest_first = np.lexsort((j, i, farthest[i, j]))
    group = list(range(len(tracks)))  # of each track: the name is one of its tracks
    for one, other in zip(i[nearest_first].tolist(), j[nearest_first].tolist(), strict=True):
        kept, gone = group[one], group[other]
        if kept != gone and farthest[kept, gone] <= _ALIKE:
            farthest[kept] = farthest[:, kept] = np.maximum(farthest[kept], farthest[gone])
            group = [kept if name == gone else name for name in group]
    persons: dict[int, int] = {}
    return tuple(persons.setdefault(name, len(persons)) for name in group)


def _distances(tracks: Sequence[FaceTrack | FaceShape], skin_rgb: Floats) -> Floats:
    """(n, n) rms difference of the tracks' proportions in spreads, infinite between those that cannot be one person."""
    lab = cv2.cvtColor(skin_rgb[:, None] / np.float32(255), cv2.COLOR_RGB2Lab)[:, 0] if len(tracks) else skin_rgb
    known = [face_proportions(track) for track in tracks]
    unknown = np.full(len(_SPREAD), np.inf, np.float32)
    proportions = np.array([unknown if one is None else one for one in known]).reshape(-1, len(_SPREAD))
    first, last = (np.array([getattr(track, name) for track in tracks]) for name in ("first", "last"))
    out = np.full((len(tracks), len(tracks)), np.inf, np.float32)
    for i in np.flatnonzero(np.isfinite(proportions).all(axis=1)):  # a row at once: all would be eleven times as many
        lightness, *chroma = (lab - lab[i]).T
        alike = (np.hypot(*chroma) <= _ALIKE_CHROMA) & (np.abs(lightness) <= _ALIKE_LIGHTNESS)
        apart = (last < first[i]) | (last[i] < first)
        off = np.sqrt((((proportions - proportions[i]) / _SPREAD) ** 2).mean(axis=1))
        out[i] = np.where(alike & apart, off, np.inf)
    return out
