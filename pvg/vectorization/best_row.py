"""The row of a track that a reference is taken from.

A reference gives one frame to every clip that is made to look like it, so its frames compete.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import cv2
import numpy as np

from pvg._arrays import Bytes, Doubles, Floats
from pvg.face import Landmarks, layout
from pvg.landmarks import FaceTrack
from pvg.picture import Picture, as_picture, median_lab, off_usual_skin
from pvg.skin import Matte
from pvg.vectorization.key_frames import first_good_row
from pvg.vectorization.surroundings import surroundings

_FRONTAL_DEG = 25.0  # off straight, a frame keeps 0.6 of its merit
_LEVEL_PITCH_DEG = 7.0  # what faces held straight measure
_SHARPNESS_FACE_PX = 128  # sharpness is compared at one size
_BLACK, _WHITE = 10, 250
_OPEN_MOUTH = 0.25  # lip gap over the mouth's width that halves a frame's merit
# how much farther off skin's usual chroma than the row in the most usual light, from which to which a row loses for its
# coloured lamp, and what is left of its merit then [by eye]
_COLOURED, _LEFT = (8.0, 25.0), 0.3
_COLOUR_PX = 32  # pixels across a face that tell its colour
_LOOKED_AT = 5  # frames whose skin is cut to see whether something covers it
_HAIRY_OR_RED = (layout.LEFT_BROW, layout.RIGHT_BROW, layout.LIPS_OUTER)


def best_row(
    track: FaceTrack, frames: Iterable[tuple[int, Picture | Bytes]], matte_of: Callable[[int, Picture], Matte]
) -> int:
    """The row that shows the face best: frontal, certain, calm, sharp, large, well lit, nothing in front of it.

    frames: (index, picture or RGB) in order, once over (part of) the track;  matte_of: the matte of a row in its
    picture, of which only the face's surroundings are kept. Each quality is a factor in [0, 1]; the matte is asked
    for in the few rows that are best in the others.
    """
    merits = _merits(track)
    sharpness, evenness = np.zeros((2, len(track.score)))
    off_skin = np.full(len(track.score), np.inf)
    best: dict[int, Picture] = {}  # only the pictures of the best rows so far are held
    for index, frame in frames:
        row = index - track.first
        if not 0 <= row < len(track.score) or track.score[row] <= 0:
            continue
        picture = as_picture(frame)
        face = _face_crop(picture, track.landmarks[row].points)
        merits[row] *= _exposed(face, track, row) ** 2  # burnt-out faces are also even and full of edges
        sharpness[row] = _sharpness(face)
        evenness[row] = _evenness(picture, track.landmarks[row])
        off_skin[row] = _off_skin(face)
        best[row] = picture.part(surroundings(track.landmarks[row]))
        if len(best) > 4 * _LOOKED_AT:
            so_far = merits * _usual(sharpness) * _usual(evenness) * _usually_lit(off_skin)
            ranked = sorted(best, key=lambda r: so_far[r], reverse=True)
            best = {r: best[r] for r in ranked[: 2 * _LOOKED_AT]}
    if not best:
        return first_good_row(track)
    merits *= _usual(sharpness) * _usual(evenness) * _usually_lit(off_skin)
    finalists = sorted(best, key=lambda r: merits[r], reverse=True)[:_LOOKED_AT]
    return max(finalists, key=lambda r: merits[r] * _shown_skin(matte_of(r, best[r]), track, r))


def _merits(track: FaceTrack) -> Doubles:
    """(n,) frontality, certainty, size and calm as a factor in [0, 1], 0 where the face is not seen."""
    points = track.landmarks.points.astype(np.float64)

    def between(a: int, b: int) -> Doubles:
        return np.asarray(np.linalg.norm(points[:, a] - points[:, b], axis=1))

    yaw, pitch = track.pose[:, 0].astype(np.float64), track.pose[:, 1] - _LEVEL_PITCH_DEG
    frontal = np.exp(-(yaw**2 + pitch**2) / (2 * _FRONTAL_DEG**2))
    widths = np.ptp(points[:, layout.CONTOUR], axis=1).max(axis=1)
    # an open mouth or a closed eye puts its inside or the lid where the curves expect lips and the eye
    gap = between(*layout.LIP_GAP) / np.maximum(between(*layout.MOUTH_CORNERS), 1e-6)
    open_eyes = np.minimum(
        between(*layout.LEFT_LIDS) / between(*layout.LEFT_EYE_CORNERS),
        between(*layout.RIGHT_LIDS) / between(*layout.RIGHT_EYE_CORNERS),
    )
    usual = np.percentile(open_eyes[track.score > 0], 75)
    calm = np.minimum(1.0, open_eyes / usual) / (1.0 + (gap / _OPEN_MOUTH) ** 2)
    return np.asarray(frontal * track.score * np.sqrt(widths / widths.max()) * calm)


def _face_crop(picture: Picture, points: Floats) -> Bytes:
    """The part of the picture within the box of the face contour, empty when that is outside."""
    height, width = picture.size
    x0, y0 = (max(0, int(v)) for v in np.floor(points[layout.CONTOUR].min(axis=0)))
    x1, y1 = (int(v) + 1 for v in np.ceil(points[layout.CONTOUR].max(axis=0)))
    y0 = max(0, min(y0, int(points[layout.UPPER_BROW_EDGES, 1].min())))
    x1, y1 = min(x1, width), min(y1, height)
    if x0 >= x1 or y0 >= y1:
        return np.zeros((0, 0, 3), np.uint8)
    part = picture.part((x0, y0, x1, y1))
    left, top = part.box[:2]
    return part.rgb()[y0 - top : y1 - top, x0 - left : x1 - left]


def _sharpness(crop: Bytes) -> float:
    """Variance of the Laplacian over that of the picture, at one size, so that neither size nor light count."""
    if min(crop.shape[:2]) < 8:
        return 0.0
    scale = min(1.0, _SHARPNESS_FACE_PX / crop.shape[1])
    grey = cv2.cvtColor(crop, cv2.COLOR_RGB2GRAY)
    small = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA).astype(np.float32)
    return float(cv2.Laplacian(small, cv2.CV_32F).var() / (small.var() + 1.0))


def _usual(quality: Doubles) -> Doubles:
    """A quality as a factor: frames that lack it lose, but what the best quarter has more wins nothing.

    So a blurred frame loses and wrinkles do not count as sharpness.
    """
    known = quality[quality > 0]
    usual = float(np.percentile(known, 75)) if len(known) else 1.0
    return np.asarray(np.minimum(1.0, quality / usual))


def _off_skin(crop: Bytes) -> float:
    """`off_usual_skin` of a face; infinite for none."""
    if not crop.size:
        return float("inf")
    small = cv2.resize(crop, (_COLOUR_PX, _COLOUR_PX), interpolation=cv2.INTER_AREA)
    return off_usual_skin(median_lab(small.reshape(-1, 3).astype(np.float32)))


def _usually_lit(off_skin: Doubles) -> Doubles:
    """How far faces are off the usual chroma of skin as a factor, beside the one in the most usual light."""
    further = off_skin - min(float(off_skin.min()), 1e3)
    share = np.clip((further - _COLOURED[0]) / (_COLOURED[1] - _COLOURED[0]), 0.0, 1.0)
    return np.asarray(1.0 - (1.0 - _LEFT) * share)


def _evenness(picture: Picture, landmarks: Landmarks) -> float:
    """How alike the two halves of a face are: low where a hand lies on one of them, alike in all frames otherwise."""
    size = _SHARPNESS_FACE_PX // 2
    places = np.array([(0.3, 0.3), (0.7, 0.3), (0.5, 0.75)], np.float32) * (size - 1)
    to_source = np.asarray(cv2.getAffineTransform(places, landmarks.eyes_and_mouth), np.float64)
    patch = picture.warp(to_source, (size, size))
    grey = cv2.GaussianBlur(cv2.cvtColor(patch, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0), 2)
    difference = np.percentile(np.abs(grey - grey[:, ::-1]), 90)  # a hand covers a part only
    return float(1.0 / (difference / (grey.std() + 1.0) + 0.05))


def _exposed(crop: Bytes, track: FaceTrack, row: int) -> float:
    """Share of the face that is inside the picture and neither black nor burnt out."""
    if not crop.size:
        return 0.0
    _, middle, brightest = np.moveaxis(np.sort(crop, axis=2), 2, 0)
    good = (brightest > _BLACK) & (middle < _WHITE)  # red alone is at white on much skin that is well lit
    contour = track.landmarks.points[row, layout.CONTOUR]
    low, high = contour.min(axis=0), contour.max(axis=0)
    whole = float(np.prod(np.maximum(high - low, 1.0)))
    return float(good.mean()) * float(min(1.0, good.size / whole))


def _shown_skin(matte: Matte, track: FaceTrack, row: int) -> float:
    """Share of the face oval without brows and lips that the matte shows as skin."""
    face = track.landmarks[row]
    oval = np.zeros(matte.alpha.shape, np.uint8)
    center = face.axes.center
    inner = center + 0.9 * (face.oval - center)
    cv2.fillPoly(oval, [np.rint(matte.raster.to_cells(inner)).astype(np.int32)], 1)
    for feature in _HAIRY_OR_RED:
        cv2.fillPoly(oval, [np.rint(matte.raster.to_cells(face.points[feature])).astype(np.int32)], 0)
    area = int(oval.sum())
    return float(np.sum(matte.alpha / 255.0 * oval)) / area if area else 0.0
