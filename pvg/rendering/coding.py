"""Colours of a look in the code values of the clip it is drawn into.

A look is made of SDR-referred colours, as faces were looked at. What is drawn are luma and chroma in the clip's own
codes; where those are not SDR's (PQ, HLG, camera logarithms, pictures with a profile), boundary colours are mapped
back to them one by one,

    g_codes = M c⁻¹(g)

The pixels I stay as they are, so u' = λI + H(g' − λg) costs no more, and own colours still return the clip.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pvg._arrays import Doubles, Floats
from pvg.haze import shown_through, through_haze
from pvg.looks import to_rgb
from pvg.video import PixelFormat

_GREY = 0.002  # of all codes: less chroma says nothing of a ratio
_LEAST = 0.02  # of a ratio: what the codes cannot hold has no chroma left [measured: skin has 0.13 at least, in LogC4]


@dataclass(frozen=True)
class Coding:
    """The code values of one format;  haze: levels of it that lie over all colours (`pvg.haze`)."""

    format: PixelFormat
    haze: int = 0

    def colors(self, colors: Floats | Doubles) -> Floats:
        """Luma and chroma (n, 3), black aside, of SDR-referred RGB colours (n, 3), 0-255."""
        shown = through_haze(colors, self.haze)
        own = shown if self.format.color is None else self.format.color.from_sdr(shown)
        return np.asarray(own, np.float32) @ self.format.opponent.matrix.astype(np.float32).T

    def in_sdr(self, codes: Floats) -> Floats:
        """What luma and chroma (..., 3), black aside, would be if the same colours were coded as SDR.

        Ratios of them mean the same in all clips then: a logarithm makes chroma a third of what it is beside luma.
        """
        if self.format.color is None:
            return codes
        matrix = self.format.opponent.matrix
        own = codes.reshape(-1, 3) @ np.linalg.inv(matrix).T
        return np.asarray(self.format.color.to_sdr(own) @ matrix.T, np.float32).reshape(codes.shape)

    def of_sdr_chroma(self, colors: Doubles) -> Doubles:
        """The chroma that SDR-referred RGB colours (n, 3), 0-255, have here over what it would be in SDR codes: (n,).

        Grey has none, and is given the ratio of the colours beside it in their order.
        """
        if self.format.color is None:
            return np.full(len(colors), shown_through(self.haze))
        own, sdr = (
            np.hypot(*np.asarray(coding.colors(colors)[:, 1:], np.float64).T)
            for coding in (self, Coding(replace(self.format, color=None)))
        )
        known = sdr > _GREY * 2.0**self.format.depth
        if not known.any():
            return np.ones(len(colors))
        places = np.arange(len(colors))
        return np.asarray(np.maximum(np.interp(places, places[known], own[known] / sdr[known]), _LEAST))

    def changes(self, changes: Floats, around: Floats) -> Doubles:
        """Luma and chroma (P, 3) that parts gain by `Look.parts` (P, 3) on a skin of mean colour `around` (n, 3)."""
        gained, matrix = to_rgb(changes.astype(np.float64)), self.format.opponent.matrix
        if self.format.color is None:
            return np.asarray(gained @ matrix.T)
        base = around.mean(axis=0, dtype=np.float64)[None]
        return np.asarray((self.format.color.from_sdr(base + gained) - self.format.color.from_sdr(base)) @ matrix.T)
