"""Faces as landmarks: made up, found in a real portrait, or taken from an asset and put elsewhere."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from pvg.asset import FaceInFrame
from pvg.face import Landmarks, layout
from pvg.landmarks import Mesh, detect_faces, fit_landmarks
from pvg.skin import Matte
from pvg.video import read_image
from scripts.samples import fetch_samples

STACKED_COUNT = layout.LANDMARK_COUNT + layout.SKIN_COUNT
_EYES = ((layout.LEFT_EYE_CONTOUR, -0.22), (layout.RIGHT_EYE_CONTOUR, 0.22))


def rolled(points: np.ndarray, angle: float) -> np.ndarray:
    """Points (..., 2) turned clockwise about the origin by an angle in radians."""
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s], [-s, c]])


def made_up_landmarks(
    width: float = 200.0, center: tuple[float, float] = (150.0, 160.0), angle: float = 0.0
) -> Landmarks:
    """Eyes where eyes are, a half-circle jaw, the rest scattered inside the face."""
    stacked = np.random.default_rng(5).uniform(-0.3, 0.3, (STACKED_COUNT, 2))
    turn = np.linspace(0, np.pi, len(layout.CONTOUR))
    stacked[layout.CONTOUR] = np.stack([-0.5 * np.cos(turn), 0.6 * np.sin(turn)], axis=1)
    for eye, x in _EYES:
        ring = np.linspace(0, 2 * np.pi, len(eye), endpoint=False)
        stacked[eye] = 0.06 * np.stack([np.cos(ring), np.sin(ring)], axis=1) + (x, -0.15)
    return Landmarks.unstack((rolled(stacked, angle) * width + center).astype(np.float32))


def read_rgb(path: Path) -> np.ndarray:
    """A picture file as (H, W, 3) uint8 RGB."""
    return read_image(path).rgb()


def fit_surest(rgb: np.ndarray) -> Mesh:
    """The mesh of the face that the detector is surest of."""
    return fit_landmarks(rgb, detect_faces(rgb)[0])


def fit_widest(rgb: np.ndarray) -> Landmarks:
    """The landmarks of a picture's widest face."""
    meshes = [fit_landmarks(rgb, face).points for face in detect_faces(rgb)]
    return Landmarks.from_mesh(max(meshes, key=lambda mesh: np.ptp(mesh[:, 0])))


@cache
def _portrait() -> np.ndarray:
    """(194, 2) stacked landmarks of a real frontal face, 1 wide, the middle of its oval at the origin."""
    face = fit_widest(read_rgb(fetch_samples().pale_portrait))
    return (face.stacked - face.oval.mean(axis=0)) / np.ptp(face.points[layout.CONTOUR, 0])


def real_landmarks(width: float = 1.0, center: tuple[float, float] = (0.0, 0.0), angle: float = 0.0) -> Landmarks:
    """The landmarks of a real frontal face, that wide, the middle of its oval at `center`."""
    return Landmarks.unstack((rolled(_portrait(), angle) * width + np.array(center)).astype(np.float32))


def turned_landmarks(mesh: Mesh, yaw: float, width: float = 150.0) -> Landmarks:
    """The landmarks of a fitted face, that wide before it is turned to the image's right by `yaw` degrees."""
    solid = np.column_stack([mesh.points, mesh.depth])
    solid = (solid - solid.mean(axis=0)) * width / np.ptp(solid[:, 0])
    across = np.cos(np.radians(yaw)) * solid[:, 0] - np.sin(np.radians(yaw)) * solid[:, 2]
    return Landmarks.from_mesh(np.column_stack([across, solid[:, 1]]).astype(np.float32) + np.float32(width))


def moved(face: FaceInFrame, x: float, y: float = 0.0, scale: float = 1.0) -> FaceInFrame:
    """A face of an asset elsewhere in the picture and of another size."""
    center = face.landmarks.points.mean(axis=0)
    shift = np.array([x, y], np.float32)

    def place(points: np.ndarray) -> np.ndarray:
        return ((points - center) * scale + center + shift).astype(np.float32)

    return replace(
        face,
        landmarks=Landmarks.unstack(place(face.landmarks.stacked)),
        boundary=place(face.boundary),
        matte=Matte.over(place(face.matte.raster.box.reshape(2, 2)).ravel(), face.matte.alpha),
    )


def turned(face: FaceInFrame, yaw: float) -> FaceInFrame:
    """A face of an asset whose head is said to be turned by so many degrees; its landmarks stay."""
    return replace(face, pose=np.array([yaw, 0, 0], np.float32))
