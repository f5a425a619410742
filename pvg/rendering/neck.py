"""Where a face's matte ends when its person's other skin is left: it goes over softly at the foot of the neck."""

from __future__ import annotations

import numpy as np

from pvg._arrays import Floats, smoothstep
from pvg.face import layout
from pvg.rendering.placed_face import PlacedFace

# below the chin, of the width of the face: from where the neck fades, and where the chest begins [by eye]
_NECK, _CHEST = 0.4, 0.8


def without_chest(face: PlacedFace, alpha: Floats) -> Floats:
    """A matte (h, w) of the face's window down to the neck; `alpha` itself where the window ends above it."""
    landmarks = face.data.landmarks
    axes, chin = landmarks.axes, landmarks.points[layout.CHIN]
    xs = np.arange(alpha.shape[1], dtype=np.float32) + np.float32(face.x - chin[0])
    ys = np.arange(alpha.shape[0], dtype=np.float32) + np.float32(face.y - chin[1])
    below = (xs[None] * axes.down[0] + ys[:, None] * axes.down[1]) / np.float32(max(axes.width, 1.0))
    if below.max() <= _NECK:
        return alpha
    return np.asarray(alpha * smoothstep(below, _CHEST, _NECK), np.float32)
