from __future__ import annotations

import cv2
import numpy as np

from pvg.landmarks import Mesh, head_pose
from tests.gallery.faces import fit_surest


def test_pose_follows_mirroring_and_turning(portrait: np.ndarray, mesh: Mesh) -> None:
    yaw, pitch, roll = head_pose(mesh)
    flipped = head_pose(fit_surest(np.ascontiguousarray(portrait[:, ::-1])))
    np.testing.assert_allclose(flipped, [-yaw, pitch, -roll], atol=3)
    height, width = portrait.shape[:2]
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), -15, 1)  # clockwise in the picture
    turned = head_pose(fit_surest(cv2.warpAffine(portrait, turn, (width, height), borderMode=cv2.BORDER_REPLICATE)))
    np.testing.assert_allclose(turned[2], roll + 15, atol=2)
