"""Whether another person has taken a face's place without a cut: in a wipe, a cover, an iris or a slow dissolve.

The mesh follows whatever face is there. So a face is looked at once more, laid straight, and compared with itself a
second ago; whether the picture around it has become another one, `CutDetector` tells.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import cv2
import numpy as np

from pvg._arrays import Floats
from pvg.face import Landmarks
from pvg.picture import Picture
from pvg.raster import scaled

LAG, EVERY = 24, 3
"""Steps from a view of a face to the one that it is compared with, and from one view to the next."""
_LIKENESS = 0.5
"""Correlation of two views below which they show different people. [measured: one person in 24 frames 0.57 at least,
but where heads turn or hands pass; frontal faces of different people 0.28 in the median, 0.71 at most for 95 %]"""
_SAME = 0.9
"""Correlation of two views from which on they show one person, whatever became of the picture. [measured: people who
are alike 0.81 in the mean]"""
_TURNED_DEG, _TURNED_BETWEEN_DEG = 25.0, 15.0  # yaw; yaw and pitch between two views
_VIEW_PX = 32
_PLACES = np.array([(0.28, 0.35), (0.72, 0.35), (0.5, 0.8)], np.float32) * (_VIEW_PX - 1)  # eyes and mouth
_BLUR_PX = 1.0


@dataclass(frozen=True, eq=False)
class _View:
    """A face laid straight, (32, 32) float32 of zero mean and unit length, and its (3,) yaw, pitch, roll in degrees."""

    pixels: Floats
    pose: Floats


@dataclass
class FaceViews:
    """The views of one face over the last LAG steps, each EVERY steps from the one before.

    step: frames, see `frames_a_step`.
    """

    step: int = 1
    _views: deque[tuple[int, _View]] = field(default_factory=lambda: deque(maxlen=LAG // EVERY + 1))

    def add(self, frame: int, picture: Picture, landmarks: Landmarks, pose: Floats) -> None:
        """Remember how the face looks in a frame;  pose: (3,) yaw, pitch, roll, degrees."""
        self._views.append((frame, _View(_laid_straight(picture, landmarks), pose)))

    def likeness(self, picture: Picture, landmarks: Landmarks, pose: Floats) -> float | None:
        """Correlation of a face with the oldest view, in [-1, 1]; None without one in a pose to be compared."""
        if not self._views:
            return None
        oldest, seen = self._views[0][1], _View(_laid_straight(picture, landmarks), pose)
        return float((oldest.pixels * seen.pixels).sum()) if _comparable(oldest, seen) else None

    def show_same(self) -> bool:
        """Whether the last view surely shows the person of LAG steps ago."""
        if not self._reach_back():
            return False
        first, last = self._views[0][1], self._views[-1][1]
        return _comparable(first, last) and float((first.pixels * last.pixels).sum()) >= _SAME

    def show_another(self) -> bool:
        """Whether the last two views show another person than the first two of LAG steps ago."""
        if not self._reach_back():
            return False
        (first, second), (last_but_one, last) = ([self._views[k][1] for k in pair] for pair in ((0, 1), (-2, -1)))
        return _comparable(first, last) and all(
            float((a.pixels * b.pixels).sum()) < _LIKENESS
            for a, b in ((first, last), (second, last), (first, last_but_one))
        )

    def _reach_back(self) -> bool:
        return len(self._views) > LAG // EVERY and self._views[-1][0] - self._views[0][0] == LAG * self.step


def _comparable(a: _View, b: _View) -> bool:
    between = float(np.abs(a.pose[:2] - b.pose[:2]).max())
    return max(abs(float(a.pose[0])), abs(float(b.pose[0]))) <= _TURNED_DEG and between <= _TURNED_BETWEEN_DEG


def _laid_straight(picture: Picture, landmarks: Landmarks) -> Floats:
    """Luma of a face with its eyes and mouth in their places, (32, 32) float32 of zero mean and unit length."""
    marks = landmarks.eyes_and_mouth
    apart = float(np.linalg.norm(marks[1] - marks[0]) / (_PLACES[1, 0] - _PLACES[0, 0]))  # source px a pixel
    fine = max(1, int(np.ceil(apart)))  # a large face is averaged down, so that it does not alias
    to_source = np.asarray(cv2.getAffineTransform(scaled(_PLACES, fine), marks), np.float64)
    seen = cv2.cvtColor(picture.warp(to_source, (_VIEW_PX * fine,) * 2), cv2.COLOR_RGB2GRAY)
    small = cv2.resize(seen, (_VIEW_PX, _VIEW_PX), interpolation=cv2.INTER_AREA).astype(np.float32)
    view = np.asarray(cv2.GaussianBlur(small, (0, 0), _BLUR_PX), np.float32)
    view -= view.mean()
    return np.asarray(view / max(float(np.linalg.norm(view)), 1e-3), np.float32)
