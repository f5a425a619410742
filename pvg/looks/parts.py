"""Parts are differences to the skin: lips, lids, cheeks and brows take what sets the reference's apart from its skin.

Skin goes to skin by one smooth map F. A part goes with it, as it would in another light; lips keep what sets them apart
from the skin, which F lessens as if it were a stain, and brows are hair, which keeps its own hue. From there a part
goes some way towards the reference's difference between part and skin: how much darker it is, and how far its chroma is
from what the reference's skin has at that luma, so that shading is not taken for make-up. Both are bounded by what such
a part can be, and a part that the reference shows under a beard, in shadow or not at all stays with the skin; so do all
in light of nearly one colour.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from pvg._arrays import Bools, Doubles, Floats, ramp, short_turn
from pvg._checks import real_number
from pvg.asset import KeyFrame
from pvg.curves import table_labels
from pvg.face import PARTS
from pvg.looks.opponent import median_luma, to_opponent
from pvg.looks.skin_map import SkinMap
from pvg.looks.usual_chroma import UsualChroma
from pvg.picture import median_lab

MAKEUP = 0.75  # default strength of every part [by eye]
Makeup = float | Mapping[str, float]


_LIP_TURN = (2.0, 18.0)  # degrees of lips from the skin's hue towards red [measured: 30 faces, 2 to 30]
_LIP_HUE = 68.0  # degrees from yellow towards magenta: beyond, lips look mauve
# of the skin's luma: hair above the mouth is darker [measured: moustaches 0.27 to 0.56, skin 0.72 to 1.21], and lips in
# its shade, under its hairs, are darker than this
_MOUSTACHE, _BESIDE_MOUSTACHE = 0.62, 0.6
# of the skin's luma, that lips may be darker by where they are that much redder than the skin, levels of R − Y [by eye]
_DEEPER, _DEEP_RED = 0.2, (15.0, 40.0)
# powers of the strength where the reference's lips are redder than the clip's, beside their skins, and where they are
# less red: half strength gives a lipstick by a quarter and takes it away by an eighth, for painted lips and drained
# ones look ill; full strength does both [by blind choice: 2 rather than 1 or 3 for redder ones; by eye]
_TAKEN, _KEPT = 2.0, 3.0
# the same for lids: what is dark of a reference's is mostly the shade of its sockets, which on another face looks like
# tired eyes or smoky eye shadow [by blind choice: 8 rather than 3, and 3 rather than 1]
_SHADED = 6.0
_HAIR = (0.5, 0.95)  # of the skin's luma: a brow that is darker shows hair, a lighter one skin [by eye]
_AS_DARK = 0.9  # of what F brightens hair by, taken away [by blind choice: 0.9 rather than 0.5 or 0]
_LEAST_CHROMA = 4.0  # levels: greyer skin has no hue
# of CIELAB [measured: skin of 15 clips and 16 portraits has 13 to 62 degrees]: a skin's hue, how far off it is the
# light's, and the chroma below which it is chance
_SKIN_HUE, _STRANGE, _HUELESS = 45.0, (45.0, 70.0), (6.0, 12.0)
_LIT = (45.0, 65.0)  # C* that only coloured light gives skin [measured: looks on usual skin have 34 at most]


@dataclass(frozen=True, eq=False)
class _Face:
    """The face of a clip that parts are on.

    skin: the map F of its skin;  key: as it is before;  luma: of the skin that F makes;  shown: how far the light shows
    what sets its parts apart, in [0, 1].
    """

    skin: SkinMap
    key: KeyFrame
    luma: float
    shown: float

    @classmethod
    def of(cls, skin: SkinMap, key: KeyFrame) -> _Face:
        """A face with some skin."""
        made = skin(key.skin)
        return cls(skin, key, median_luma(made), _shown_by_light(np.asarray(made, np.float32)))


@dataclass(frozen=True)
class _Part:
    """What a part can be beside the skin of its face [by eye].

    step: most of the skin's luma that the clip's own part gets darker or lighter;  blue, red: B − Y and R − Y, levels,
    beyond the skin's usual chroma at that luma;
    shown: least and most of the skin's luma that the reference's part can have, outside it is a shadow, a beard or a
    highlight;  least_red: R − Y beyond the skin's that it has at least, levels.
    """

    step: tuple[float, float]
    blue: tuple[float, float]
    red: tuple[float, float]
    shown: tuple[float, float]
    least_red: float = -np.inf

    def least_shown(self, reference: KeyFrame, red: float) -> float:
        """The least of `shown` beside a reference's skin. red: R − Y of its part beyond the skin's, levels, or NaN."""
        return self.shown[0]

    def bare(self, moved: Doubles, own: Doubles, face: _Face) -> Doubles:
        """(3,) the part without make-up: F has moved its `own` colour (3,) to `moved` (3,)."""
        return moved

    def made_up(self, change: Floats, ours: Doubles, own: Doubles, face: _Face, strength: float) -> Floats:
        """(3,) float32, what is added to `ours` (3,), the part without make-up, when `change` (3,) is asked for."""
        return np.float32(face.shown * strength) * change


class _Lips(_Part):
    """Keep what sets them apart from the skin, and are of a hue that lips can have."""

    def least_shown(self, reference: KeyFrame, red: float) -> float:
        """Less where it is deep red, which is a lipstick and no shadow; more under a moustache."""
        low = self.shown[0]
        low = max(low, _BESIDE_MOUSTACHE) if _moustache(reference) else low
        return low - _DEEPER * float(ramp(red, *_DEEP_RED))  # NaN of lips that are not seen

    def bare(self, moved: Doubles, own: Doubles, face: _Face) -> Doubles:
        """With what F takes away, as far as lips can be so."""
        return _as_lips(moved + _lost(own, face), own, face)

    def made_up(self, change: Floats, ours: Doubles, own: Doubles, face: _Face, strength: float) -> Floats:
        """As far as lips can be so, see `_TAKEN`."""
        lips = _as_lips(ours + change, own, face)
        power = _KEPT if _redder(lips, face.skin) < _redder(ours, face.skin) else _TAKEN
        return np.float32((face.shown * strength) ** power) * (lips - ours).astype(np.float32)


class _Lids(_Part):
    """Take what is dark of the reference's with care."""

    def made_up(self, change: Floats, ours: Doubles, own: Doubles, face: _Face, strength: float) -> Floats:
        """See `_SHADED`."""
        return np.float32((face.shown * strength) ** _SHADED) * change


class _Brows(_Part):
    """Are hair."""

    def bare(self, moved: Doubles, own: Doubles, face: _Face) -> Doubles:
        """With the hue and saturation of hair."""
        return moved + face.shown * _hair_lacks(moved, own, face.key)


_PARTS = {
    # less red is a beard or a shadow
    "lips": _Lips((0.3, 0.2), (-25.0, 20.0), (-4.0, 60.0), (0.45, 1.2), least_red=-3.0),
    "lids": _Lids((0.22, 0.08), (-8.0, 4.0), (-8.0, 5.0), (0.4, 1.25)),
    # less red is another light than the face's, grey or violet patches on one that is lit evenly [by blind choice]
    "cheeks": _Part((0.0, 0.0), (-12.0, 10.0), (-10.0, 18.0), (0.6, 1.5), least_red=0.0),
    "brows": _Brows((0.1, 0.02), (-6.0, 6.0), (-6.0, 6.0), (0.2, 1.05)),
}


def strengths(makeup: Makeup) -> Floats:
    """(P,) the strength of every part of PARTS. Raises `ValueError` on an unknown part or one not in [0, 1]."""
    given = dict(makeup) if isinstance(makeup, Mapping) else dict.fromkeys(PARTS, makeup)
    if unknown := [part for part in given if part not in PARTS]:
        raise ValueError(f"no part {unknown[0]!r} to make up; known are {', '.join(PARTS)}")
    shares = {part: real_number(f"makeup of {part}", share, 0.0, 1.0) for part, share in given.items()}
    return np.array([shares.get(part, MAKEUP) for part in PARTS], np.float32)


@dataclass(frozen=True, eq=False)
class PartChanges:
    """What a reference's parts ask for, before they meet those of a clip.

    luma: (P,) of the skin's, NaN where nothing is asked;  chroma: (P, 2) B − Y and R − Y beyond the skin's usual one.
    """

    luma: Doubles
    chroma: Doubles

    @classmethod
    def of(cls, reference: KeyFrame) -> PartChanges:
        """What sets a reference's parts apart from its skin; parts that it does not show ask for nothing."""
        parts = to_opponent(reference.parts)
        luma = parts[:, 0] / median_luma(reference.skin)
        chroma = parts[:, 1:] - UsualChroma.of(to_opponent(reference.skin)).at(parts[:, 0])
        for p, name in enumerate(PARTS):
            part = _PARTS[name]
            hidden = not part.least_shown(reference, chroma[p, 1]) <= luma[p] <= part.shown[1]  # NaN is not seen
            if hidden or chroma[p, 1] < part.least_red:
                luma[p], chroma[p] = np.nan, 0.0
        return cls(luma, chroma)

    def on(self, skin: SkinMap, key: KeyFrame, strength: Floats) -> Floats:
        """(P, 3) luma, B − Y and R − Y, levels, to add to a clip's parts that the skin's map F has moved.

        strength: (P,) in [0, 1], of each part.
        """
        out = np.zeros((len(PARTS), 3), np.float32)
        if not len(key.skin):
            return out
        face = _Face.of(skin, key)
        moved, own = to_opponent(skin(key.parts)), to_opponent(key.parts)
        for p, name in enumerate(PARTS):
            if np.isnan(moved[p, 0]):
                continue
            part = _PARTS[name]
            ours = part.bare(moved[p], own[p], face)
            gained = ours - moved[p]
            if not np.isnan(self.luma[p]):
                change = self._asked(p, part, ours, face)
                gained = gained + part.made_up(change, ours, own[p], face, float(strength[p]))
            out[p] = gained
        return out

    def _asked(self, p: int, part: _Part, ours: Doubles, face: _Face) -> Floats:
        """(3,) what leads from `ours` (3,), a clip's part without make-up, to the reference's, within its bounds."""
        change = np.zeros(3, np.float32)
        change[0] = np.clip(face.luma * self.luma[p] - ours[0], -part.step[0] * face.luma, part.step[1] * face.luma)
        usual, then = (face.skin.goal.at(np.array([luma]))[0] for luma in (ours[0], ours[0] + change[0]))
        for channel, bound in enumerate((part.blue, part.red)):
            beyond = _within(self.chroma[p, channel], bound, ours[1 + channel] - usual[channel])
            change[1 + channel] = then[channel] + beyond - ours[1 + channel]
        return change


def _shown_by_light(skin: Floats) -> float:
    """How far the light on a face shows what sets its parts apart, in [0, 1]: 0 in blue, green or deep red light.

    skin: (n, 3) colours that F makes, 0-255 RGB. What is red in white light blue light does not show, and red light
    nothing that is blue: lips would turn teal, orange or magenta.
    """
    _, a, b = (float(value) for value in median_lab(skin))
    chroma, off = float(np.hypot(a, b)), abs(short_turn(float(np.degrees(np.arctan2(b, a))) - _SKIN_HUE))
    return 1 - max(float(ramp(off, *_STRANGE) * ramp(chroma, *_HUELESS)), float(ramp(chroma, *_LIT)))


def _lost(lips: Doubles, face: _Face) -> Doubles:
    """(3,) what F takes away of a clip's lips, (3,) their own colour, beside its skin, as if they were a stain on it.

    In less light there is less of it.
    """
    beyond = lips[1:] - face.skin.own.at(lips[:1])[0]
    return np.concatenate([[0.0], (min(1.0, face.luma / median_luma(face.key.skin)) - face.skin.spread) * beyond])


def _hair_lacks(moved: Doubles, own: Doubles, key: KeyFrame) -> Doubles:
    """(3,) what a brow that F has `moved` lacks to its own hue and saturation, as far as it is darker than the skin.

    Hair does not take the skin's colour: F would turn grey brows ginger on tanned skin, and red ones grey on pale skin.
    Nor does it get bright with the skin, while the hair above stays dark; with less light all of a face gets darker.
    """
    hair = 1.0 - float(ramp(own[0] / median_luma(key.skin), *_HAIR))
    luma = float(moved[0] - _AS_DARK * hair * max(moved[0] - own[0], 0.0))
    return np.concatenate([[luma - moved[0]], hair * (own[1:] * luma / max(own[0], 1.0) - moved[1:])])


def _redder(part: Doubles, skin: SkinMap) -> float:
    """R − Y of a part's colour (3,) beyond what is usual on skin that is as bright, levels."""
    return float(part[2] - skin.goal.at(part[:1])[0, 1])


def _moustache(reference: KeyFrame) -> bool:
    """Whether what is above the mouth is much darker than the open skin."""
    above = _above_the_mouth() & reference.visible
    return bool(above.any() and median_luma(reference.colors[above]) < _MOUSTACHE * median_luma(reference.skin))


@cache
def _above_the_mouth() -> Bools:
    """(S,) the samples of the table on the upper lip's skin."""
    return table_labels().on_curves("upper_lip")


def _as_lips(lips: Doubles, own: Doubles, face: _Face) -> Doubles:
    """(3,) the colour nearest to `lips` whose hue lips can have beside the skin that F makes.

    own: of the clip's lips, beside the skin they are on now: what they already are, lips can be.
    """
    ours = face.skin.own.at(np.array([median_luma(face.key.skin)]))[0]
    theirs = face.skin.goal.at(np.array([face.luma]))[0]
    if min(np.hypot(*ours), np.hypot(*theirs), np.hypot(*own[1:]), np.hypot(*lips[1:])) < _LEAST_CHROMA:
        return lips
    around, before = _hue(theirs), short_turn(_hue(own[1:]) - _hue(ours))
    least, most = min(_LIP_TURN[0], before), max(_LIP_TURN[1], before)
    reddest = max(_LIP_HUE, _hue(own[1:]))
    turned = np.clip(short_turn(_hue(lips[1:]) - around), least, max(least, min(most, reddest - around)))
    chroma, angle = float(np.hypot(*lips[1:])), np.radians(around + turned)
    return np.array([lips[0], -chroma * np.cos(angle), chroma * np.sin(angle)])


def _hue(chroma: Doubles) -> float:
    """Degrees from yellow (0) over red (about 60), magenta (above 90) and blue (180) to cyan (240) of B − Y and R − Y.

    In [-90, 270): it jumps between cyan and green, where no skin is.
    """
    return short_turn(float(np.degrees(np.arctan2(chroma[1], -chroma[0]))) - 90.0) + 90.0


def _within(wanted: float, bounds: tuple[float, float], own: float) -> float:
    """What is wanted, within bounds that have room for what the clip's part already is."""
    return float(np.clip(wanted, min(bounds[0], own), max(bounds[1], own)))
