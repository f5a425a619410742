"""Faces to find skin in: real pictures, and drawn scenes whose true skin is known."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from pvg.face import Landmarks, layout
from pvg.landmarks import detect_faces, fit_landmarks
from pvg.skin import Matte
from scripts.samples import fetch_samples

TONES = {
    "pale": ((235, 200, 185), (70, 90, 120)),
    "tan": ((190, 140, 105), (40, 60, 50)),
    "dark": ((85, 55, 42), (150, 165, 175)),
    "in blue light": ((120, 115, 190), (60, 70, 60)),
    "grey": ((170, 168, 166), (60, 61, 60)),
}
_DARKNESS = (
    (layout.LEFT_EYE_CONTOUR, 0.3),
    (layout.RIGHT_EYE_CONTOUR, 0.3),
    (layout.LIPS_OUTER, 0.8),
    (layout.LEFT_BROW, 0.35),
    (layout.RIGHT_BROW, 0.35),
)
# eyes, nose and mouth; brows end at the temples, maybe under hair
ON_SKIN = [*range(43, 64), *range(72, 104)]


def read_rgb(path: Path) -> np.ndarray:
    image = cv2.imread(str(path))
    assert image is not None
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def landmarks_of(rgb: np.ndarray) -> Landmarks:
    """Those of the widest face."""
    meshes = [fit_landmarks(rgb, face) for face in detect_faces(rgb)]
    return Landmarks.from_mesh(max(meshes, key=lambda mesh: np.ptp(mesh.points[:, 0])).points)


@cache
def frontal_face() -> np.ndarray:
    """(194, 2) landmarks of a real frontal face, 1 wide, chin line downwards, around the origin."""
    face = landmarks_of(read_rgb(fetch_samples().pale_portrait))
    return (face.stacked - face.oval.mean(axis=0)) / np.ptp(face.points[layout.CONTOUR, 0])


@dataclass(frozen=True)
class Scene:
    """A drawn face on a plain ground, and its true skin."""

    rgb: np.ndarray
    landmarks: Landmarks
    truth: np.ndarray


def draw_scene(
    center: tuple[float, float] = (160, 130),
    width: float = 120,
    tone: str = "tan",
    size: tuple[int, int] = (320, 320),
    gain: float = 1.0,
    seed: int = 0,
) -> Scene:
    stacked = (frontal_face() * width + np.array(center)).astype(np.float32)
    landmarks = Landmarks.unstack(stacked)
    chin = landmarks.points[layout.CHIN]
    neck = np.array([[-0.33, -0.5], [0.33, -0.5], [0.33, 0.75], [-0.33, 0.75]]) * width + chin
    face = cv2.convexHull(stacked)[:, 0]
    truth = np.zeros(size, np.uint8)
    for polygon in (face, neck):
        cv2.fillPoly(truth, [np.rint(polygon * 16).astype(np.int32)], (1,), shift=4)
    skin, ground = (np.array(color, np.float32) for color in TONES[tone])
    ys, xs = np.mgrid[: size[0], : size[1]]
    shade = 1 - 0.25 * np.clip((xs - center[0]) / width, -1, 1) - 0.15 * np.clip((ys - chin[1]) / width, 0, 1)
    picture = np.where(truth[..., None] > 0, skin * shade[..., None], ground)
    for indices, dark in _DARKNESS:
        hole = np.zeros(size, np.uint8)
        cv2.fillPoly(hole, [np.rint(landmarks.points[indices] * 16).astype(np.int32)], (1,), shift=4)
        picture[hole > 0] = skin * dark
    picture = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 0.8) * gain
    picture += np.random.default_rng(seed).normal(0, 2, picture.shape)
    return Scene(np.clip(picture, 0, 255).astype(np.uint8), landmarks, truth > 0)


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / max((a | b).sum(), 1))


def mask_of(matte: Matte, shape: tuple[int, ...]) -> np.ndarray:
    return matte.mask_at(np.arange(shape[1], dtype=np.float32), np.arange(shape[0], dtype=np.float32))


def alpha_of(matte: Matte, shape: tuple[int, ...]) -> np.ndarray:
    return matte.alpha_at(np.arange(shape[1], dtype=np.float32), np.arange(shape[0], dtype=np.float32))
