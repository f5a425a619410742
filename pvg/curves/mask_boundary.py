"""The mask boundary as a curve: where rays from the face's centre leave the skin."""

from __future__ import annotations

import numpy as np

from pvg._arrays import Floats
from pvg._compiled import kernel
from pvg.curves.labels import BOUNDARY_SAMPLES
from pvg.face import FaceAxes

_RAY_STEP = 0.5  # cells of the matte between two readings along a ray [by eye: a crossing is interpolated between them]


def _rays(axes: FaceAxes) -> Floats:
    """(BOUNDARY_SAMPLES, 2) unit vectors at equal angles, the first towards the chin."""
    angle = np.arange(BOUNDARY_SAMPLES) * (2 * np.pi / BOUNDARY_SAMPLES)
    rays: Floats = (np.cos(angle)[:, None] * axes.down + np.sin(angle)[:, None] * axes.across).astype(np.float32)
    return rays


def boundary_radius(matte: Floats, axes: FaceAxes) -> Floats:
    """Distance of the skin's outer boundary, where the matte falls through 1/2, from the face's centre.

    matte: (H, W) float32 in [0, 1];  axes: of the face in the matte's pixels.
    Returns (BOUNDARY_SAMPLES,) float32 pixels at equal angles, 0 where a ray meets no skin. Along a ray the last
    crossing counts, so a fold of the contour (an ear, the jaw above the neck) is crossed straight and never traced
    twice; between steps it is interpolated, so the boundary moves smoothly as the matte does.
    """
    x, y = (np.float32(v) for v in axes.center)
    count = int(np.ceil(float(np.hypot(*matte.shape)) / _RAY_STEP))
    radius = np.empty(BOUNDARY_SAMPLES, np.float32)
    _last_crossing(np.ascontiguousarray(matte, np.float32), x, y, _rays(axes), np.float32(_RAY_STEP), count, radius)
    return radius


def boundary_points(radius: Floats, axes: FaceAxes) -> Floats:
    """Positions (BOUNDARY_SAMPLES, 2) of the boundary samples at `radius` from the face's centre."""
    return axes.center + _rays(axes) * radius[:, None]


@kernel(fastmath=True)
def _last_crossing(
    matte: Floats, center_x: np.float32, center_y: np.float32, rays: Floats, step: np.float32, count: int, out: Floats
) -> None:
    """out (n,) = the distance along each ray (n, 2) at which the matte (h, w) last falls through 1/2, 0 for never.

    The matte is read bilinearly, 0 beyond its cells, at `count` points `step` apart.
    """
    h, w = matte.shape
    for n in range(len(out)):
        beyond, found = np.float32(0.0), np.float32(0.0)
        for s in range(count - 1, -1, -1):
            x, y = center_x + rays[n, 0] * step * s, center_y + rays[n, 1] * step * s
            value = np.float32(0.0)
            if -1.0 < x < w and -1.0 < y < h:
                x0, y0 = int(np.floor(x)), int(np.floor(y))
                fx, fy = np.float32(x - x0), np.float32(y - y0)
                for dy in range(2):
                    for dx in range(2):
                        if 0 <= x0 + dx < w and 0 <= y0 + dy < h:
                            weight = (fx if dx else np.float32(1.0) - fx) * (fy if dy else np.float32(1.0) - fy)
                            value += weight * matte[y0 + dy, x0 + dx]
            if value >= np.float32(0.5):
                share = (value - np.float32(0.5)) / max(value - beyond, np.float32(1e-6))
                found = (np.float32(s) + min(max(share, np.float32(0.0)), np.float32(1.0))) * step
                break
            beyond = value
        out[n] = found
