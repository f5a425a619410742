"""What the open skin of a face says against taking its colours: no skin's colour, burnt out, nearly black."""

from __future__ import annotations

import numpy as np

from pvg._arrays import Floats
from pvg.picture import median_lab

# of CIELAB: hues from red to yellow in degrees, and the most chroma, that skin has in light without a colour of its own
# [measured: 15 clips and 16 portraits have 13 to 62 degrees and C* up to 39]
_HUES, _RICHEST = (0.0, 90.0), 55.0
_GREY = 6.0  # C*, below which a hue says nothing
_BLACK = 12.0  # L*
_BURNT, _MOST = 254.0, 0.4  # level of a channel, and share of the skin at it


def doubts(skin: Floats) -> tuple[str, ...]:
    """What speaks against the colours (n, 3) of a face's open skin, 0-255 RGB, in words; nothing without any."""
    if not len(skin):
        return ()
    lightness, a, b = (float(v) for v in median_lab(skin))
    chroma, hue = float(np.hypot(a, b)), float(np.degrees(np.arctan2(b, a)))
    found = []
    if chroma > _RICHEST or (chroma > _GREY and not _HUES[0] <= hue <= _HUES[1]):
        found.append("its skin has a colour that skin has not: coloured light, paint, or something that covers it")
    if lightness < _BLACK:
        found.append("its skin is nearly black, and its colours a guess")
    if float((skin.max(axis=1) >= _BURNT).mean()) > _MOST:
        found.append("much of its skin is burnt out, and its colours a guess")
    return tuple(found)
