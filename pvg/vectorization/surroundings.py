"""The part of a picture around a face that is kept of a frame: its skin is found there."""

from __future__ import annotations

import numpy as np

from pvg.face import Landmarks
from pvg.picture import Box
from pvg.skin import face_box

_MARGIN, _MARGIN_PX = 0.08, 8.0  # around a face's box: smoothing moves it a little


def surroundings(landmarks: Landmarks, aspect: float | None = None) -> Box:
    """The part of a picture that a face's skin is found in, with a margin.

    aspect: width over height that it has at least the room for, whatever the head's turn.
    """
    x0, y0, x1, y1 = (float(v) for v in face_box(landmarks))
    wide, high = x1 - x0, y1 - y0
    if aspect is not None:
        wide, high = max(wide, high * aspect), max(high, wide / aspect)
    half = np.array([wide, high]) * (0.5 + _MARGIN) + _MARGIN_PX
    low, top = np.array([x0 + x1, y0 + y1]) / 2 - half, np.array([x0 + x1, y0 + y1]) / 2 + half
    return int(low[0]) - 1, int(low[1]) - 1, int(top[0]) + 2, int(top[1]) + 2
