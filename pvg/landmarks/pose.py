"""Head pose from the mesh's own depth."""

from __future__ import annotations

import numpy as np

from pvg._arrays import Floats
from pvg.face import layout
from pvg.landmarks.mesh import Mesh


def head_pose(mesh: Mesh) -> Floats:
    """Return (yaw, pitch, roll) in degrees as (3,) float32; zero looks straight out of the picture.

    yaw > 0: the face is turned to the image's right; pitch > 0: downwards; roll > 0: the head leans clockwise.
    The network's depth is its guess from one picture: faces held straight measure pitches of 0 to 15.
    """
    points = np.column_stack([mesh.points, mesh.depth]).astype(np.float64)  # x right, y down, z away
    left, right = (points[list(side)] for side in zip(*layout.MESH_MIRROR_PAIRS, strict=True))
    across = (right - left).sum(axis=0)
    across /= max(float(np.linalg.norm(across)), 1e-9)
    down = points[layout.MESH_CHIN].mean(axis=0) - points[layout.MESH_FOREHEAD].mean(axis=0)
    down -= across * (down @ across)
    down /= max(float(np.linalg.norm(down)), 1e-9)
    forward = -np.cross(across, down)
    yaw = np.arctan2(forward[0], -forward[2])
    pitch = np.arctan2(forward[1], np.hypot(forward[0], forward[2]))
    # what is left once yaw and pitch are undone turns the x axis in the picture plane
    level = np.array([np.cos(yaw), 0.0, np.sin(yaw)])
    roll = np.arctan2(across @ np.cross(-forward, level), across @ level)
    return np.degrees([yaw, pitch, roll]).astype(np.float32)
