"""Looks are made of colours with less haze, and drawn under it again (`pvg.haze`).

Haze is of the picture and not of a face: moved along with its colours, a face would stand before the picture that it
is in. But who looks at a hazy face compares the colours that are seen. So half of the haze is taken off, of a
reference's too. With P = v + (1 − v / 255) I, a change of I becomes (1 − v / 255) times that change, and own colours
still return the clip.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pvg.asset import FaceRecord, KeyFrame
from pvg.haze import Colors, cleared, shown_through

_SHARE = 0.5  # of the haze [by blind choice: rather than all of it or none]


def with_less_haze(record: FaceRecord) -> FaceRecord:
    """A face whose key frames have the colours that they would have without a part of its haze: that is its `haze`."""
    haze = round(_SHARE * record.haze)
    return replace(record, key_frames=tuple(_clear_key(key, haze) for key in record.key_frames), haze=haze)


def _clear_key(key: KeyFrame, haze: int) -> KeyFrame:
    if haze == 0:
        return key
    colors, skin, parts = (np.maximum(cleared(each, haze), 0) for each in (key.colors, key.skin, key.parts))
    return replace(key, colors=colors, skin=skin, parts=parts)


def under_haze(own: Colors, clear: Colors, new: Colors, haze: int) -> Colors:
    """What colours `own` (…, 3), `clear` without haze, become where those become `new`, 0-255 RGB."""
    return new if haze == 0 else own + shown_through(haze) * (new - clear)
