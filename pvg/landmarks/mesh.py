"""Fit the 478-point face mesh to one face: an upright square crop, the network, and the way back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pvg import models
from pvg._arrays import Bytes, Floats
from pvg.face import layout
from pvg.landmarks.detector import Detection
from pvg.picture import Picture, as_picture
from pvg.raster import from_edge
from pvg.region import Region

INPUT_PX = 256
REGION_GROWTH = 1.5
"""Side of the crop over the longer side of the face box, as the network was trained."""


@dataclass(frozen=True)
class Mesh:
    """The fitted face mesh.

    points: (478, 2) float32 source pixels; depth: (478,) float32 in the same unit, smaller is nearer;
    score: probability in [0, 1] that the crop shows a face.
    """

    points: Floats
    depth: Floats
    score: float


def region_of_detection(detection: Detection) -> Region:
    """Crop for a freshly detected face, in which the eyes are level."""
    x0, y0, x1, y1 = (float(value) for value in detection.box)
    dx, dy = (float(value) for value in detection.key_points[1] - detection.key_points[0])
    return Region((x0 + x1) / 2, (y0 + y1) / 2, REGION_GROWTH * max(x1 - x0, y1 - y0), float(np.arctan2(dy, dx)))


def region_of_points(points: Floats) -> Region:
    """Crop around a face whose mesh points (478, 2) are known, from this frame or the one before."""
    left, right = layout.MESH_OUTER_EYE_CORNERS
    dx, dy = (float(value) for value in points[right] - points[left])
    angle = float(np.arctan2(dy, dx))
    cos, sin = np.cos(angle), np.sin(angle)
    turned = points @ np.array([[cos, -sin], [sin, cos]], np.float32)  # along and across the eye line
    low, high = turned.min(axis=0), turned.max(axis=0)
    along, across = (low + high) / 2
    return Region(
        float(along * cos - across * sin),
        float(along * sin + across * cos),
        REGION_GROWTH * float((high - low).max()),
        angle,
    )


def fit_landmarks(picture: Picture | Bytes, region: Region | Detection) -> Mesh:
    """Fit the mesh to the face in a region.

    picture: a picture or (H, W, 3) uint8 RGB. A Detection is fitted twice, the second time in the crop its own points
    ask for. Raises ModelError when the weights are not installed.
    """
    picture = as_picture(picture)
    if isinstance(region, Detection):
        first = fit_landmarks(picture, region_of_detection(region))
        return fit_landmarks(picture, region_of_points(first.points))
    to_source, pixels = region.to_source(INPUT_PX), region.read(picture, INPUT_PX)
    session = models.load("face_landmarks_detector")
    values = np.multiply(pixels[None], np.float32(1 / 255), dtype=np.float32)
    flat, flag = session.run(["Identity", "Identity_1"], {session.get_inputs()[0].name: values})
    found = flat.reshape(-1, 3)
    points = from_edge(found[:, :2]) @ to_source[:, :2].T + to_source[:, 2]
    depth = found[:, 2] * (region.size / INPUT_PX)
    score = 1 / (1 + float(np.exp(-np.clip(flag.item(), -50, 50))))
    return Mesh(points.astype(np.float32), depth.astype(np.float32), score)
