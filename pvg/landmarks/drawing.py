"""Draw landmarks over a picture, for `pvg inspect --layer landmarks` and for looking at them."""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Bytes, Floats
from pvg.face import layout
from pvg.raster import SUBPIXEL_BITS, fixed_point

_COLORS = {
    "contour": (255, 210, 0),
    "left_brow": (0, 220, 90),
    "right_brow": (0, 220, 90),
    "nose_ridge": (255, 120, 0),
    "nose_base": (255, 120, 0),
    "left_nose_side": (255, 120, 0),
    "right_nose_side": (255, 120, 0),
    "left_eye": (0, 200, 255),
    "right_eye": (0, 200, 255),
    "lips_outer": (255, 40, 90),
    "lips_inner": (255, 130, 200),
    "pupils": (255, 255, 255),
}


def draw_landmarks(rgb: Bytes, points: Floats) -> Bytes:
    """Return a copy of rgb, (H, W, 3) uint8, with the landmark groups drawn in; points: (106, 2)."""
    drawn = rgb.copy()
    unit = 1 << SUBPIXEL_BITS
    width = float(np.ptp(points[layout.CONTOUR, 0]))
    radius, thickness = max(1.0, width / 150), max(1, round(width / 300))
    for name, group in layout.LANDMARK_GROUPS.items():
        corners = fixed_point(points[group])
        color = _COLORS[name]
        if name != "pupils":
            cv2.polylines(drawn, [corners], name in layout.CLOSED_GROUPS, color, thickness, cv2.LINE_AA, SUBPIXEL_BITS)
        for x, y in corners:
            cv2.circle(drawn, (int(x), int(y)), round(radius * unit), color, -1, cv2.LINE_AA, SUBPIXEL_BITS)
    return drawn
