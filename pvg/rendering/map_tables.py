"""A face's map of colour F as tables over the code values of a clip's planes.

Luma takes a table, chroma tables of luma,

    Y' = T(Y)        c' = m'(T(Y)) + k (c − m(Y))

What luma gains is kept apart by slopes of T above 1 and below: the first see a smoothed picture, see `planes`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from pvg._arrays import Bools, Doubles, Floats, ramp
from pvg._compiled import kernel
from pvg.looks import LEAST_TINGE, LookMap, Region, SkinMap, likeness
from pvg.rendering.coding import Coding
from pvg.video import PixelFormat

_APART = 0.12  # of the usual chroma, and e of `tinge` besides: about how far from it skin may stay [by eye]
_HOLLOW = (0.4, 0.8)  # of the skin's middle luma, between which that begins to hold: hollows are deep red [by eye]
# d of `foreign`, up to which a colour may be skin's and from which on it is none: of pixels [measured: none inside the
# mattes of 15 clips and 14 portraits is beyond the first, letters in plain colours are beyond the second], and of what
# is fitted at curves [by eye]
_FOREIGN, _FOREIGN_AT_CURVES = (1.6, 2.1), (0.9, 1.3)
_NO_CHROMA = np.float32(1e-3)  # of e of `tinge`
_IN_SHADE = 0.7  # of the usual chroma of the skin's middle, which counts at least [by eye: nostrils are a deep red]
_SAMPLES_BESIDE = np.ones((11, 1), np.uint8)


@dataclass(frozen=True, eq=False)
class MapTables:
    """A map F on the planes of one format, strength applied.

    tone: (2, n) float32 what luma gains by its code, by slopes of T above 1 and below;
    chroma: (2, n) float32 what each chroma plane gains by luma's code, `excess` of its own code aside;
    offset: (3,) the codes of black and of grey;  usual: (2, n) float32 the chroma, above grey, of skin by luma's code;
    least: (n,) float32 e of `tinge` by luma's code;
    told: (2, n) r of `tinge` up to which it is grey and from which on it is skin, by luma's code;
    levels: (n,) the SDR-referred luma, haze off, that a code stands for, 0-255;
    bound: (n,) w of `bounded` by luma's code;
    beard: in [0, 1], see `LookMap`;  middle: the skin's middle luma, as `levels`;
    spread, broad: k of single pixels and of patches, see `SkinMap`, strength and exposure applied;
    farther: of d of `foreign`, from 1: how much farther off a colour must be that is none of the skin's.
    """

    tone: Floats
    chroma: Floats
    excess: float
    offset: Floats
    usual: Floats
    least: Floats
    told: Floats
    levels: Floats
    bound: Floats
    beard: float
    middle: float
    spread: float
    broad: float
    farther: float = 1.0

    @classmethod
    def of(
        cls,
        look_map: LookMap,
        pixel_format: PixelFormat,
        gain: float = 1.0,
        kept: float = 1.0,
        tint: Sequence[float] = (1.0, 1.0, 1.0),
        *,
        region: Region = "face",
    ) -> MapTables:
        """The tables of a look's map for the opponent planes of a format.

        gain, kept, tint: see `KeyExposure`;  region: see `LookMap.usual_colors`.
        """
        coding, skin, strength = Coding(pixel_format, look_map.haze), look_map.skin, look_map.strength
        codes, offset = np.arange(2.0**pixel_format.depth), pixel_format.opponent.offset
        colors, goals = (np.array(tint) * known for known in look_map.usual_colors(region))
        # (256, 3) the codes of the usual colours, and those of what F makes of them
        own, new = (np.asarray(coding.colors(of) + offset, np.float64) for of in (gain * colors, kept * goals))

        def by_code(values: Doubles) -> Doubles:
            """Values (256,) that go with the usual colours, by luma's code."""
            return _read(codes, own[:, 0], values)

        middle = int(np.argmin(np.abs(codes - own[128, 0])))
        tone = strength * np.stack(_rise_and_fall(by_code(new[:, 0] - own[:, 0]), middle))
        excess = strength * (skin.spread * kept / gain - 1.0)
        chroma = [strength * by_code(new[:, p] - own[:, p]) - excess * by_code(own[:, p]) for p in (1, 2)]
        usual = np.asarray([by_code(own[:, p]) - offset[p] for p in (1, 2)], np.float32)
        grey = 2.0**pixel_format.depth / 256.0 * LEAST_TINGE * coding.of_sdr_chroma(gain * colors)
        least = by_code(grey).astype(np.float32)
        levels = np.arange(256.0)
        bound = np.zeros(len(codes), np.float32)
        if region != "face":
            lit = by_code(ramp(levels / skin.own.middle, *_HOLLOW))
            bound = (_bound(skin, usual, least) * lit).astype(np.float32)
        share = strength * kept / gain
        return cls(
            tone=tone.astype(np.float32),
            chroma=np.asarray(chroma, np.float32),
            excess=float(excess),
            offset=offset.astype(np.float32),
            usual=usual,
            least=least,
            told=np.asarray([by_code(each) for each in look_map.told_from_grey(levels)], np.float32),
            levels=by_code(levels).astype(np.float32),
            bound=bound,
            beard=look_map.beard,
            middle=skin.own.middle,
            spread=share * skin.spread,
            broad=share * skin.broad,
        )

    @cached_property
    def alikeness(self) -> tuple[Floats, Floats, Floats]:
        """How far r of `tinge` is between both of `told`, c₁ a[Y] + c₂ b[Y] + d[Y]: a, b and d, (n,) by luma's code."""
        size, least, (grey, skin) = np.hypot(*self.usual), self.least, self.told
        wide = skin - grey
        # beyond white usual chroma is 0 but for rounding, which has no direction
        some = np.where(size > _NO_CHROMA * least, self.usual, np.float32(0))
        a, b = some / (np.maximum(size * (size + least), np.float32(1e-6)) * wide)
        return a, b, (least / (size + least) - grey) / wide

    def level_of(self, luma: Floats) -> Floats:
        """`levels` at codes of luma (n,)."""
        return np.asarray(_at_codes(luma, self.levels), np.float32)

    def likeness(self, colors: Floats) -> Floats:
        """r (n,) of `tinge` of codes of luma and chroma (n, 3)."""
        blue, red, least = (_at_codes(colors[:, 0], table) for table in (*self.usual, self.least))
        return np.asarray(likeness(colors[:, 1:] - self.offset[1:], np.stack([blue, red], axis=1), least), np.float32)

    def foreign(self, codes: Floats, where: Bools, lips: Bools | None = None, around: Floats | None = None) -> Floats:
        """How far codes of luma and chroma (3, r, c) are none of the skin's colours, see `foreign`: (r, c) in [0, 1].

        where: (r, c), elsewhere it is 0;  lips: (r, c), where what is redder than skin is none the less skin;
        around: (2, r, c) how far skin nearby is off the usual chroma, not at all when None.
        """
        low, high = (self.farther * bound for bound in _FOREIGN)
        return self._off_skin(codes, where, lips, around, (low, high))

    def foreign_at_curves(self, g: Floats) -> Floats:
        """The same (n,) of boundary colours g (n, 3), black aside, in the order of their curves.

        A curve may lead through letters. Fits mix them with the skin around, and samples beside them take part.
        """
        codes = np.ascontiguousarray((g + self.offset).T[:, :, None], np.float32)
        off = self._off_skin(codes, np.ones((len(g), 1), np.bool_), None, None, _FOREIGN_AT_CURVES)
        return np.asarray(cv2.dilate(off, _SAMPLES_BESIDE)[:, 0] if off.any() else off[:, 0], np.float32)

    def off_usual(self, codes: Floats) -> Floats:
        """(2, r, c) how far codes of luma and chroma (3, r, c) are off the skin's usual chroma."""
        luma = np.clip(codes[0], 0, self.usual.shape[1] - 1).astype(np.int32)
        return np.asarray(codes[1:] - self.offset[1:, None, None] - self.usual[:, luma], np.float32)

    def off_usual_in_d(self, codes: Floats) -> Floats:
        """The same by what d of `foreign` is measured by."""
        luma = np.clip(codes[0], 0, self.usual.shape[1] - 1).astype(np.int32)
        return np.asarray(self.off_usual(codes) / self._scale[luma], np.float32)

    def _off_skin(
        self, codes: Floats, where: Bools, lips: Bools | None, around: Floats | None, bounds: tuple[float, float]
    ) -> Floats:
        """`foreign`, rising from 0 to 1 between two bounds of d."""
        lips = np.zeros_like(where) if lips is None else lips
        around = np.zeros((2, *where.shape), np.float32) if around is None else around
        out = np.zeros(where.shape, np.float32)
        low, high = (np.float32(bound) for bound in bounds)
        _find_foreign(codes, where, lips, around, self.usual, self.least, self._scale, self.offset, low, high, out)
        return out

    @cached_property
    def _scale(self) -> Floats:
        """(n,) what d of `foreign` is measured by, by luma's code."""
        size = np.hypot(*self.usual)
        middle = size[int(np.argmin(np.abs(self.levels - self.middle)))]
        return np.asarray(np.maximum(size, _IN_SHADE * middle) + 2.0 * self.least, np.float32)

    def gained(self, colors: Floats) -> Floats:
        """What luma and chroma (n, 3), black aside, gain."""
        own = np.asarray(colors + self.offset, np.float32)
        return self.gained_of(own, own)

    def gained_more_by(self, other: MapTables, own: Floats) -> Floats:
        """What codes of luma and chroma (n, 3) gain more by another map of the same format than by this one: (3, n)."""
        tables = [other.tone.sum(axis=0) - self.tone.sum(axis=0), *(other.chroma - self.chroma)]
        gained = np.stack([_at_codes(own[:, 0], table) for table in tables])
        gained[1:] += (other.excess - self.excess) * own[:, 1:].T
        return np.asarray(gained, np.float32)

    def gained_of(self, own: Floats, broad: Floats) -> Floats:
        """What codes of luma and chroma (…, 3) gain;  broad: the same, smoothed as `planes` has it."""
        rise, fall = self.tone
        luma = _at_codes(broad[..., 0], rise) + _at_codes(own[..., 0], fall)
        wide = broad if self.excess > 0 else own
        chroma = [_at_codes(broad[..., 0], self.chroma[p - 1]) + self.excess * wide[..., p] for p in (1, 2)]
        return np.asarray(np.stack([luma, *chroma], axis=-1), np.float32)


def _rise_and_fall(gained: Doubles, middle: int) -> tuple[Doubles, Doubles]:
    """What luma gains (n,) by its code, by slopes of T above 1 and below: the first nothing at the code `middle`."""
    slopes = np.diff(gained, prepend=gained[0])
    summed = np.cumsum(np.maximum(slopes, 0))
    rise = summed - summed[middle]
    return rise, gained - rise


def _bound(skin: SkinMap, usual: Floats, least: Floats) -> float:
    """The most of w of `bounded`, in codes.  usual, least: see `MapTables`."""
    size = np.hypot(*usual)
    at = int(np.argmax(size))  # in HDR and logarithms dark codes have far larger steps: e of them is no measure here
    return (skin.moved / (_APART * float(size[at]) + float(least[at]))) ** 2


def _read(codes: Doubles, at: Doubles, values: Doubles) -> Doubles:
    """Values (n,) known at increasing `at` (n,), read at `codes`; constant beyond."""
    return np.asarray(np.interp(codes, np.maximum.accumulate(at), values))


def _at_codes(codes: Floats, table: Floats) -> Doubles:
    """A table (n,) by code, read between codes (…) and constant beyond."""
    places = np.ascontiguousarray(codes, np.float32)
    out = np.empty(places.size, np.float64)
    _interpolate(places.reshape(-1), np.ascontiguousarray(table), out)
    return out.reshape(places.shape)


@kernel()
def _interpolate(places: Floats, table: Floats, out: Doubles) -> None:
    """out (m,) = a table (n,) of even steps read at places (m,), as `numpy.interp` does, which looks for each step."""
    last = len(table) - 1
    for i in range(len(places)):
        place = np.float64(places[i])
        if place >= last:
            out[i] = table[last]
        elif place > 0.0:
            k = int(place)
            low = np.float64(table[k])
            out[i] = (np.float64(table[k + 1]) - low) * (place - k) + low
        else:
            out[i] = place if np.isnan(place) else table[0]


@kernel()
def _find_foreign(
    codes: Floats,
    where: Bools,
    lips: Bools,
    around: Floats,
    usual: Floats,
    least: Floats,
    scale: Floats,
    offset: Floats,
    low: np.float32,
    high: np.float32,
    out: Floats,
) -> None:
    """`MapTables.foreign` into zeros (r, c), rising from `low` to `high` of d."""
    one, two, most = np.float32(1.0), np.float32(2.0), usual.shape[1] - 1
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            if not where[i, j]:
                continue
            code = min(max(int(codes[0, i, j]), 0), most)
            own_blue, own_red = usual[0, code], usual[1, code]
            blue, red = codes[1, i, j] - offset[1] - own_blue, codes[2, i, j] - offset[2] - own_red
            far = np.sqrt(blue * blue + red * red)
            if far <= low * scale[code] or (lips[i, j] and red > abs(blue)):
                continue
            near_blue, near_red = around[0, i, j], around[1, i, j]
            size = np.sqrt((own_blue + near_blue) ** 2 + (own_red + near_red) ** 2) + two * least[code]
            beside = np.sqrt((blue - near_blue) ** 2 + (red - near_red) ** 2) / max(size, scale[code])
            d = min(far / scale[code], beside)
            if d > low:
                out[i, j] = min((d - low) / (high - low), one)
