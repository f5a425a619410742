"""A face's map of colour F as tables over the code values of a clip's planes.

Luma takes a table, chroma tables of luma,

    Y' = T(Y)        c' = m'(T(Y)) + k (c − m(Y))

What luma gains is kept apart by slopes of T above 1 and below: the first see a smoothed picture, see `planes`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pvg._arrays import Doubles, Floats
from pvg.looks import LookMap, Region
from pvg.rendering.coding import Coding
from pvg.video import PixelFormat


@dataclass(frozen=True, eq=False)
class MapTables:
    """A map F on the planes of one format, strength applied.

    tone: (2, n) float32 what luma gains by its code, by slopes of T above 1 and below;
    chroma: (2, n) float32 what each chroma plane gains by luma's code, `excess` of its own code aside;
    offset: (3,) the codes of black and of grey;  usual: (2, n) float32 the chroma, above grey, of skin by luma's code;
    alike: r of the skin that is least like the rest, see `tinge`.
    """

    tone: Floats
    chroma: Floats
    excess: float
    offset: Floats
    usual: Floats
    alike: float

    @classmethod
    def of(
        cls,
        look_map: LookMap,
        pixel_format: PixelFormat,
        gain: float = 1.0,
        kept: float = 1.0,
        *,
        region: Region = "face",
    ) -> MapTables:
        """The tables of a look's map for the opponent planes of a format.

        gain, kept: see `LookMap.exposures`;  region: see `LookMap.usual_colors`.
        """
        opponent = pixel_format.opponent
        usual, goal = look_map.usual_colors(region)
        coding = Coding(pixel_format)
        source, target = (
            np.asarray(coding.colors(colors) + opponent.offset, np.float64) for colors in (gain * usual, kept * goal)
        )
        codes = np.arange(2.0**pixel_format.depth)
        gained = _read(codes, source[:, 0], target[:, 0] - source[:, 0])
        slopes = np.diff(gained, prepend=gained[0])
        middle = int(np.argmin(np.abs(codes - source[128, 0])))
        summed = np.cumsum(np.maximum(slopes, 0))
        rise = summed - summed[middle]
        fall = gained - rise
        excess = look_map.strength * (look_map.skin.spread * kept / gain - 1.0)
        chroma = [
            look_map.strength * _read(codes, source[:, 0], target[:, p] - source[:, p])
            - excess * _read(codes, source[:, 0], source[:, p])
            for p in (1, 2)
        ]
        tone = look_map.strength * np.stack([rise, fall])
        offset = opponent.offset.astype(np.float32)
        own = np.stack([_read(codes, source[:, 0], source[:, p]) - opponent.offset[p] for p in (1, 2)])
        tables = [one.astype(np.float32) for one in (tone, np.stack(chroma), own)]
        return cls(tables[0], tables[1], float(excess), offset, tables[2], look_map.skin.alike)

    def gained(self, colors: Floats) -> Floats:
        """What luma and chroma (n, 3), black aside, gain."""
        own = np.asarray(colors + self.offset, np.float32)
        return self.gained_of(own, own)

    def gained_more_by(self, other: MapTables, own: Floats) -> Floats:
        """What codes of luma and chroma (n, 3) gain more by another map of the same format than by this one: (3, n)."""
        tables = [other.tone.sum(axis=0) - self.tone.sum(axis=0), *(other.chroma - self.chroma)]
        codes = np.arange(self.tone.shape[1], dtype=np.float32)
        gained = np.stack([np.interp(own[:, 0], codes, table) for table in tables])
        gained[1:] += (other.excess - self.excess) * own[:, 1:].T
        return np.asarray(gained, np.float32)

    def gained_of(self, own: Floats, broad: Floats) -> Floats:
        """What codes of luma and chroma (…, 3) gain;  broad: the same, smoothed as `planes` has it."""
        codes, (rise, fall) = np.arange(self.tone.shape[1], dtype=np.float32), self.tone
        luma = np.interp(broad[..., 0], codes, rise) + np.interp(own[..., 0], codes, fall)
        wide = broad if self.excess > 0 else own
        chroma = [np.interp(broad[..., 0], codes, self.chroma[p - 1]) + self.excess * wide[..., p] for p in (1, 2)]
        return np.asarray(np.stack([luma, *chroma], axis=-1), np.float32)


def _read(codes: Doubles, at: Doubles, values: Doubles) -> Doubles:
    """Values (n,) known at increasing `at` (n,), read at `codes`; constant beyond."""
    return np.asarray(np.interp(codes, np.maximum.accumulate(at), values))
