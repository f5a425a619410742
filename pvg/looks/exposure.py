"""Exposure that changes within a clip: which key frame leads a person, and how the others follow.

The map F of a person is made from one key frame. Another one, `gain` times as bright, takes it relative to its
exposure,

    g' = kept · F(g / gain),        kept = gain up to 1, above it bent so that the skin's highlights stay below white,
                                    or where that key frame has them

so the clip's own light survives as light, instead of being moved up the tone curve once more, and never runs away.
Where that light burns the clip's skin out, its highlights rise less than its exposure, and so do the new ones.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pvg._arrays import Bools, Doubles, Floats
from pvg.asset import FaceRecord, KeyFrame
from pvg.curves import table_labels
from pvg.looks.opponent import median_luma
from pvg.looks.tone import HIGHLIGHT

_LEADS_AT = 0.75  # of a person's frames, by rising exposure: brief light does not lead, brief dark neither [by eye]
_AS_BRIGHT = 1.1  # times: of key frames that are lit alike the one that serves longest leads
_GAINS = (0.05, 20.0)
_HIGHLIGHTS = 0.98  # of the skin, whose brightest channel is to stay below `HIGHLIGHT`


def leading_key(records: Sequence[FaceRecord]) -> KeyFrame:
    """The key frame that a person's map is made from: the one in whose light three quarters of their frames are.

    Those or dimmer: a map made in dim light would leave the brighter frames no room below white. Key frames whose open
    skin could be sampled come first.  records: of the person's faces, the one seen longest first.
    """
    keys = [(key, frames) for record in records for key, frames in zip(record.key_frames, record.served(), strict=True)]
    keys = [(key, frames) for key, frames in keys if len(key.skin)] or keys
    if len(keys) == 1:
        return keys[0][0]
    brightness = np.array([_brightness(key, "skin" if len(key.skin) else "curves") for key, _ in keys])
    frames = np.array([frames for _, frames in keys])
    order = np.argsort(brightness, kind="stable")
    reached = np.cumsum(frames[order]) >= _LEADS_AT * frames.sum()
    wanted = brightness[order[int(np.argmax(reached))]]
    alike = (brightness <= wanted * _AS_BRIGHT) & (brightness >= wanted / _AS_BRIGHT)
    return keys[int(np.argmax(np.where(alike, frames, -1)))][0]


def at_exposure(key: KeyFrame, gain: float) -> KeyFrame:
    """The key frame as it would be with its colours multiplied by a gain."""
    if gain == 1.0:
        return key
    colors, skin, parts = (np.asarray(c * np.float32(gain), np.float32) for c in (key.colors, key.skin, key.parts))
    return replace(key, colors=colors, skin=skin, parts=parts)


class KeyExposure(NamedTuple):
    """The exposure of a key frame beside the one that F was made from: it takes g' = kept · F(g / gain).

    gain: how many times as bright it is;  kept: how much of that its new colours keep.
    """

    gain: float
    kept: float


AS_LEADING = KeyExposure(1.0, 1.0)
"""Of a key frame that takes F as it is."""

#: the colours of a key frame's skin (n, 3) before and after F, 0-255 RGB
Moved = Callable[[KeyFrame], tuple[Floats, Floats | Doubles]]


@dataclass(frozen=True, eq=False)
class Exposure:
    """The exposure of a person's key frames relative to the leading one.

    new: the level of the highlights of the leading one's skin after F.
    """

    leading: KeyFrame
    moved: Moved
    new: float

    @classmethod
    def of_person(cls, leading: KeyFrame, moved: Moved) -> Exposure:
        """Of the key frame that F was made from, and F."""
        return cls(leading, moved, _highlights(moved(leading)[1]))

    def of(self, key: KeyFrame) -> KeyExposure:
        """The exposure of one of them.

        Its new colours keep all of a gain up to 1; above it rising ever slower until highlights come near white, but as
        much as leaves them no darker than they are in the clip.
        """
        if key is self.leading:
            return AS_LEADING
        by = "skin" if len(key.skin) and len(self.leading.skin) else "curves"
        gain = float(np.clip(_brightness(key, by) / _brightness(self.leading, by), *_GAINS))
        if gain <= 1.0:
            return KeyExposure(gain, gain)
        room = max(HIGHLIGHT / self.new - 1.0, 0.0)
        bent = 1.0 + room * (1.0 - float(np.exp(-(gain - 1.0) / room))) if room > 0.0 else 1.0
        own, new = self.moved(at_exposure(key, 1.0 / gain))
        return KeyExposure(gain, max(bent, gain * min(1.0, _highlights(own) / _highlights(new))))


def on_skin(key: KeyFrame) -> Bools:
    """(S,) bool: samples on curves of open skin that are seen, all when none is."""
    skin = table_labels().on_open_skin
    seen = np.asarray(skin & key.visible)
    return seen if seen.any() else skin


def _highlights(skin: Floats | Doubles) -> float:
    """The level that nearly all of skin's colours (n, 3) stay below in every channel, at least 1."""
    return max(float(np.quantile(skin.max(axis=1), _HIGHLIGHTS)), 1.0)


def _brightness(key: KeyFrame, by: str) -> float:
    colors = key.skin if by == "skin" else key.colors[on_skin(key)]
    return median_luma(colors)
