"""Where a face went that the network no longer knows, told by the motion of the picture.

The mesh is fitted to whole faces. One that leaves the picture, or comes so near that it overfills it, is lost while
half of it is still seen: then its points go where the corners in its picture go.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from pvg._arrays import Bytes, Doubles, Floats
from pvg.landmarks.mesh import INPUT_PX, Mesh, region_of_points
from pvg.picture import Picture
from pvg.raster import square

_CORNERS, _QUALITY, _APART = 120, 0.005, 4.0  # the last in px of the crop, as are those below
_RETURN_PX = 1.0  # how near a corner followed there and back again comes to where it was
_RESIDUAL_PX = 3.0  # of a corner that goes with the others
_LEAST_CORNERS, _LEAST_SHARE = 8, 0.3  # that must go together
_LARGEST_GROWTH = 1.25  # from frame to frame
_MARGIN_PX = 2  # of the crop, where borders are read
_LK_SIZE, _LK_LEVELS = (21, 21), 3


def share_inside(points: Floats, size: tuple[int, int]) -> float:
    """Share of points (n, 2) in source pixels that lie in a picture of (height, width) pixels."""
    height, width = size
    return float(((points >= 0) & (points < (width, height))).all(axis=1).mean())


def carried(mesh: Mesh, before: Picture, picture: Picture) -> Mesh | None:
    """The mesh of the picture before, moved by the similarity that most corners in it followed to this picture.

    Pyramidal Lucas-Kanade (Bouguet 2001), forth and back. None when too few corners go together.
    """
    region = region_of_points(mesh.points)
    to_source = region.to_source(INPUT_PX)
    grey, grey_before = (cv2.cvtColor(region.read(p, INPUT_PX), cv2.COLOR_RGB2GRAY) for p in (picture, before))
    to_crop = np.asarray(cv2.invertAffineTransform(to_source), np.float64)
    corners = cv2.goodFeaturesToTrack(
        grey_before, _CORNERS, _QUALITY, _APART, mask=_seen_face(_moved(mesh.points, to_crop), to_crop, before.size)
    )
    if corners is None or len(corners) < _LEAST_CORNERS:
        return None
    there, found = cv2.calcOpticalFlowPyrLK(  # type: ignore[call-overload]
        grey_before, grey, corners, None, winSize=_LK_SIZE, maxLevel=_LK_LEVELS
    )[:2]
    back, returned = cv2.calcOpticalFlowPyrLK(  # type: ignore[call-overload]
        grey, grey_before, there, None, winSize=_LK_SIZE, maxLevel=_LK_LEVELS
    )[:2]
    true = (found & returned).ravel().astype(bool) & (np.abs(back - corners).max(axis=(1, 2)) < _RETURN_PX)
    if true.sum() < _LEAST_CORNERS:
        return None
    motion, together = cv2.estimateAffinePartial2D(
        corners[true], there[true], method=cv2.RANSAC, ransacReprojThreshold=_RESIDUAL_PX
    )
    if motion is None or together.sum() < max(_LEAST_CORNERS, _LEAST_SHARE * len(corners)):
        return None
    motion = np.asarray(motion, np.float64)
    growth = float(np.hypot(*motion[:, 0]))
    if not 1 / _LARGEST_GROWTH < growth < _LARGEST_GROWTH:
        return None
    points = _moved(_moved(_moved(mesh.points, to_crop), motion), to_source)
    return replace(mesh, points=points, depth=np.asarray(mesh.depth * growth, np.float32))


def _moved(points: Floats, affine: Doubles) -> Floats:
    """Points (n, 2) under an affine map (2, 3)."""
    return np.asarray(points @ affine[:, :2].T + affine[:, 2], np.float32)


def _seen_face(points: Floats, to_crop: Doubles, size: tuple[int, int]) -> Bytes:
    """The part of the crop, 255, that shows the face and lies in a picture of (height, width) pixels."""
    height, width = size
    face, inside = np.zeros((2, INPUT_PX, INPUT_PX), np.uint8)
    cv2.fillConvexPoly(face, np.rint(cv2.convexHull(points)).astype(np.int32), 255)
    border = np.array([(0, 0), (width - 1, 0), (width - 1, height - 1), (0, height - 1)], np.float32)
    cv2.fillConvexPoly(inside, np.rint(_moved(border, to_crop)).astype(np.int32), 255)
    return np.asarray(cv2.erode(face & inside, square(_MARGIN_PX)), np.uint8)
