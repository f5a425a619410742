"""The complexion that a reference gives: its open skin in its key light, as the scene bears it, no greyer than skin is.

A picture's colours are as much its camera's and its grade's as its people's. Among its own dark curtains and blue
greys, skin of little chroma looks like skin; put into another picture it looks dead. So skin that is greyer than skin
of its lightness usually is gains chroma, up to that, and never beyond what the clip's own skin has: a grey film stays
grey, and a clip's own colours are themselves.
"""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Floats
from pvg.looks.key_light import in_key_light
from pvg.looks.scene import in_scene
from pvg.looks.tone import to_opponent, to_rgb

# saturation, C*/L* of CIELAB, below which skin looks grey: at L* 60, its fall a level of L*, and the most of it
# [by blind choice: less or more of it was chosen less often, at L* 60, 64, 71 and 77]
_USUAL, _FALL, _MOST = 0.36, 0.004, 0.40
_GAIN = 1.3  # of chroma, at most [by blind choice]: a grade in black and white is meant


def complexion(reference: Floats, own: Floats, scene: float) -> Floats:
    """The colours (m, 3) that open skin `own` (n, 3) is to take from a `reference`'s (k, 3), 0-255 RGB, m ≤ k.

    scene: in [0, 1], see `pvg.looks.scene`.
    """
    skin = in_key_light(reference)
    if min(len(skin), len(own)) == 0:
        return skin
    skin = in_scene(skin, own, scene)
    lightness, saturation = _saturation(skin)
    usual = min(_USUAL - _FALL * (lightness - 60.0), _MOST)
    gain = min(usual, _saturation(own)[1]) / max(saturation, 1e-6)
    if gain <= 1.0:
        return skin
    opponent = to_opponent(skin)
    opponent[:, 1:] *= min(gain, _GAIN)
    return np.asarray(np.clip(to_rgb(opponent), 0.0, 255.0), np.float32)


def _saturation(skin: Floats) -> tuple[float, float]:
    """L* and C*/L* of the median of colours (n, 3)."""
    median = (np.median(skin, axis=0) / 255.0).astype(np.float32)
    lightness, a, b = cv2.cvtColor(median.reshape(1, 1, 3), cv2.COLOR_RGB2LAB)[0, 0]
    return float(lightness), float(np.hypot(a, b)) / max(float(lightness), 1.0)
