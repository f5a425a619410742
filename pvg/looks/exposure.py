"""Exposure that changes within a clip: which key frame leads a person, and how the others follow.

The map F of a person is made from one key frame. Another one, `gain` times as bright, takes it relative to its
exposure,

    g' = kept · t · F(g / (gain · t)),  kept = gain up to 1, above it bent so that the skin's highlights stay below
                                        white, or where that key frame has them

with t the tint of its light, 1 in light of one colour: it is taken channel by channel, as von Kries has it. So the
clip's own light survives as light, instead of being moved up the tone curve once more, and never runs away. Where that
light burns the clip's skin out, its highlights rise less than its exposure, and so do the new ones.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pvg._arrays import Bools, Doubles, Floats, ramp
from pvg.asset import FaceRecord, KeyFrame
from pvg.curves import table_labels
from pvg.looks.opponent import luma_of, median_luma, to_opponent, to_rgb
from pvg.looks.tone import HIGHLIGHT
from pvg.picture import median_lab, off_usual_skin

_LEADS_AT = 0.75  # of a person's frames, by rising exposure: brief light does not lead, brief dark neither [by eye]
# how much farther off skin's usual chroma a key frame may be than the one in the most usual light [by eye]
_COLOURED = 15.0
_AS_BRIGHT = 1.1  # times: of key frames that are lit alike the one that serves longest leads
_GAINS = (0.05, 20.0)
# of the logarithms of a tint's channels: light that differs by less is of one colour, by more of another [measured: key
# frames of exposure ramps 0.06 at most]
_OF_ONE_COLOUR, _TINTS = (0.12, 0.25), (0.2, 5.0)
_GREY = 6.0  # C* of skin that tells no light: a picture that loses its colours is in no other one
_DARK = 4.0  # levels added to both sides of the ratio of a channel
_HIGHLIGHTS = 0.98  # of the skin, whose brightest channel is to stay below `HIGHLIGHT`


def leading_key(records: Sequence[FaceRecord]) -> KeyFrame:
    """The key frame that a person's map is made from: the one in whose light three quarters of their frames are.

    Those or dimmer: a map made in dim light would leave the brighter frames no room below white. Key frames whose open
    skin could be sampled come first, and of those the ones in whose light it looks like skin: under a coloured lamp
    little is known of it.  records: of the person's faces, the one seen longest first.
    """
    keys = [(key, frames) for record in records for key, frames in zip(record.key_frames, record.served(), strict=True)]
    keys = [(key, frames) for key, frames in keys if len(key.skin)] or keys
    if len(keys) == 1:
        return keys[0][0]
    colors = [_colors(key, "skin" if len(key.skin) else "curves") for key, _ in keys]
    brightness = np.array([median_luma(one) for one in colors])
    nearest = int(np.argmin(_off_skin(colors)))
    off = _off_skin(colors, float(brightness[nearest]))
    usual = off <= off[nearest] + _COLOURED
    keys, brightness = [pair for pair, so in zip(keys, usual, strict=True) if so], brightness[usual]
    frames = np.array([frames for _, frames in keys])
    order = np.argsort(brightness, kind="stable")
    reached = np.cumsum(frames[order]) >= _LEADS_AT * frames.sum()
    wanted = brightness[order[int(np.argmax(reached))]]
    alike = (brightness <= wanted * _AS_BRIGHT) & (brightness >= wanted / _AS_BRIGHT)
    return keys[int(np.argmax(np.where(alike, frames, -1)))][0]


def at_exposure(key: KeyFrame, gain: float | Doubles) -> KeyFrame:
    """The key frame as it would be with its colours multiplied by a gain, one or (3,) of each channel."""
    if np.all(gain == 1.0):
        return key
    by = np.asarray(gain, np.float32)
    colors, skin, parts = (np.asarray(c * by, np.float32) for c in (key.colors, key.skin, key.parts))
    return replace(key, colors=colors, skin=skin, parts=parts)


class KeyExposure(NamedTuple):
    """The light of a key frame beside the one that F was made from: it takes g' = kept · t · F(g / (gain · t)).

    gain: how many times as bright it is;  kept: how much of that its new colours keep;
    tint: t, (3,) R, G, B of light of another colour, whose luma is that of skin in the leading key's, 1 in its own.
    """

    gain: float
    kept: float
    tint: Doubles

    @property
    def light(self) -> Doubles:
        """(3,) by how much each channel is brighter."""
        return self.gain * self.tint

    def shown(self, changes: Floats) -> Floats:
        """Changes of new colours (n, 3) in the leading key's light, luma, B − Y and R − Y in levels, as this one's."""
        if (self.tint == 1.0).all():
            return np.asarray(np.float32(self.kept) * changes, np.float32)
        return np.asarray(to_opponent(self.kept * self.tint * to_rgb(changes.astype(np.float64))), np.float32)

    def row(self) -> tuple[float, ...]:
        """As `LookMap.exposures` has it."""
        return (self.gain, self.kept, *self.tint.tolist())


_WHITE = np.ones(3)
AS_LEADING = KeyExposure(1.0, 1.0, _WHITE)
"""Of a key frame that takes F as it is."""

#: the colours of a key frame's skin (n, 3) before and after F, 0-255 RGB
Moved = Callable[[KeyFrame], tuple[Floats, Floats | Doubles]]


@dataclass(frozen=True, eq=False)
class Exposure:
    """The exposure of a person's key frames relative to the leading one.

    moved: F, see `Moved`.
    """

    leading: KeyFrame
    moved: Moved

    def of(self, key: KeyFrame) -> KeyExposure:
        """The exposure of one of them.

        Its new colours keep all of a gain up to 1; above it rising ever slower until highlights come near white, but as
        much as leaves them no darker than they are in the clip.
        """
        if key is self.leading:
            return AS_LEADING
        by = "skin" if len(key.skin) and len(self.leading.skin) else "curves"
        own, leading = _colors(key, by), _colors(self.leading, by)
        gain = float(np.clip(median_luma(own) / median_luma(leading), *_GAINS))
        tint = _tint(own, leading)
        if gain <= 1.0 and tint is _WHITE:
            return KeyExposure(gain, gain, tint)
        new = self.moved(self.leading)[1]
        # where F itself takes highlights beyond, as the reference's own brightness may, they stay there
        limit = max(HIGHLIGHT, _highlights(new)) / _highlights(tint * new)
        surely = min(1.0, limit)
        if gain <= surely:
            return KeyExposure(gain, gain, tint)
        room = max(limit - surely, 0.0)
        bent = surely + room * (1.0 - float(np.exp(-(gain - surely) / room))) if room > 0.0 else surely
        before, after = (tint * colors for colors in self.moved(at_exposure(key, 1.0 / (gain * tint))))
        return KeyExposure(gain, max(bent, gain * min(1.0, _highlights(before) / _highlights(after))), tint)


def _tint(colors: Floats, leading: Floats) -> Doubles:
    """t of `KeyExposure` of a key frame's skin (n, 3) beside the leading one's (m, 3); 1 where either is grey."""
    as_bright = max(median_luma(colors), median_luma(leading))
    if min(float(np.hypot(*_lab(one, as_bright)[1:])) for one in (colors, leading)) < _GREY:
        return _WHITE
    here, there = (np.median(one, axis=0).astype(np.float64) for one in (colors, leading))
    ratio = np.log((here + _DARK) / (there + _DARK))
    off = ratio - np.log(float(luma_of(np.exp(ratio) * there)) / max(float(luma_of(there)), 1e-6))
    share = ramp(float(np.abs(off).max()), *_OF_ONE_COLOUR)
    return np.clip(np.exp(share * off), *_TINTS) if share > 0.0 else _WHITE


def on_skin(key: KeyFrame) -> Bools:
    """(S,) bool: samples on curves of open skin that are seen, all when none is."""
    skin = table_labels().on_open_skin
    seen = np.asarray(skin & key.visible)
    return seen if seen.any() else skin


def _highlights(skin: Floats | Doubles) -> float:
    """The level that nearly all of skin's colours (n, 3) stay below in every channel, at least 1."""
    return max(float(np.quantile(skin.max(axis=1), _HIGHLIGHTS)), 1.0)


def _off_skin(skins: Sequence[Floats], least_luma: float = 0.0) -> Doubles:
    """(m,) how far the chroma of m skins' colours (n, 3) is from what skin has in usual light, CIELAB."""
    return np.array([off_usual_skin(_lab(skin, least_luma)) for skin in skins])


def _lab(skin: Floats, least_luma: float) -> Doubles:
    """(3,) CIELAB of a skin's colours (n, 3), a dimmer one made about that bright: it is no greyer for it."""
    times = max(1.0, (least_luma + _DARK) / (median_luma(skin) + _DARK))
    return median_lab(np.float32(times) * skin)


def _colors(key: KeyFrame, by: str) -> Floats:
    """(n, 3) of its skin, by "skin" or by "curves"."""
    return key.skin if by == "skin" else key.colors[on_skin(key)]
