"""Masks against labels: ours of a still and as in clips, and the paper's rule."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.quality.faces import Bools, Image
from benchmarks.quality.measures import iou
from pvg.face import Landmarks
from pvg.landmarks import detect_faces, fit_landmarks
from pvg.skin import SkinTracker, fit_skin_model, skin_mask
from pvg.video import read_image

# face, ears, neck and the features inside, of the class indices
INSIDE_LABELS = (1, 2, 3, 4, 5, 6, 7, 8, 10, 11, 12, 13, 14)


def widest_landmarks(rgb: Image) -> Landmarks:
    """Those of the widest face of a picture."""
    meshes = [fit_landmarks(rgb, face).points for face in detect_faces(rgb)]
    widest = max(meshes, key=lambda mesh: float(np.ptp(mesh[:, 0])))
    return Landmarks.from_mesh(widest)


def _as_tracked(rgb: Image, landmarks: Landmarks) -> Bools:
    """The mask that a clip of this one frame would get."""
    matte = SkinTracker(fit_skin_model(rgb, landmarks)).step(rgb, landmarks)
    return matte.mask_at(np.arange(rgb.shape[1], dtype=np.float32), np.arange(rgb.shape[0], dtype=np.float32))


def run_masks(labelled: tuple[tuple[Path, Path], ...]) -> list[dict[str, Any]]:
    """IoU of our masks and of the paper's rule with the labelled portraits."""
    rows = []
    for portrait, labels in labelled:
        rgb = read_image(portrait).rgb()
        truth = np.isin(np.asarray(cv2.imread(str(labels), cv2.IMREAD_UNCHANGED)), INSIDE_LABELS)
        landmarks = widest_landmarks(rgb)
        rows.append(
            {
                "portrait": portrait.stem,
                "landmarks": iou(skin_mask(rgb, landmarks), truth),
                "landmarks, in clips": iou(_as_tracked(rgb, landmarks), truth),
                "ycbcr": iou(skin_mask(rgb, landmarks, mask="ycbcr"), truth),
            }
        )
    return rows
