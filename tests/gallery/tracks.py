"""Tracks of faces that nobody had to follow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pvg.face import Landmarks, layout
from pvg.landmarks import FaceTrack
from tests.gallery.faces import STACKED_COUNT


def track_of(
    stacked: np.ndarray, score: np.ndarray | None = None, pose: np.ndarray | None = None, first: int = 0
) -> FaceTrack:
    """A track of stacked points (n, 194, 2), seen in all frames and held straight unless told."""
    count = len(stacked)
    return FaceTrack(
        first,
        Landmarks.unstack(stacked.astype(np.float32)),
        np.ones(count, np.float32) if score is None else score.astype(np.float32),
        np.zeros((count, 3), np.float32) if pose is None else pose.astype(np.float32),
    )


def seen_track(scores: Sequence[float], first: int = 10, poses: np.ndarray | None = None) -> FaceTrack:
    """A track that says when a face was seen and how it was held, not where."""
    return track_of(np.zeros((len(scores), STACKED_COUNT, 2)), np.array(scores), poses, first)


def still_track(face: Landmarks, count: int, first: int = 0) -> FaceTrack:
    """A face that does not move at all."""
    return track_of(np.tile(face.stacked, (count, 1, 1)), first=first)


def nearly_still_track(face: Landmarks, first: int, count: int, stretch: float = 1.0) -> FaceTrack:
    """A still face as it is found, a tenth of a pixel beside; stretch makes its lower half that much longer."""
    points = np.tile(face.stacked, (count, 1, 1)).astype(np.float32)
    middle = face.points[layout.NOSE_RIDGE[0], 1]
    points[..., 1] = np.where(points[..., 1] > middle, middle + stretch * (points[..., 1] - middle), points[..., 1])
    points += 0.1 * np.random.default_rng(first).standard_normal(points.shape).astype(np.float32)
    return track_of(points, first=first)
