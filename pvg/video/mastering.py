"""HDR10's static metadata: the display a clip was mastered on (SMPTE ST 2086) and its light levels (CTA-861.3)."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from fractions import Fraction

_CHROMATICITY_STEPS = 50000  # a unit of ITU-T H.265, D.3.28: 0.00002
_LUMINANCE_STEPS = 10000  # 0.0001 cd/m²
_SIDE_DATA = struct.Struct("=20i2i")


@dataclass(frozen=True)
class MasteringDisplay:
    """SMPTE ST 2086: chromaticities (x, y) of the CIE 1931 diagram, 0–1, and luminances in cd/m²."""

    red: tuple[Fraction, Fraction]
    green: tuple[Fraction, Fraction]
    blue: tuple[Fraction, Fraction]
    white: tuple[Fraction, Fraction]
    least: Fraction
    most: Fraction

    @classmethod
    def of_side_data(cls, data: bytes) -> MasteringDisplay | None:
        """Read libav's AVMasteringDisplayMetadata; None when it does not hold both colours and luminances."""
        if len(data) < _SIDE_DATA.size:
            return None
        *numbers, has_colors, has_luminances = _SIDE_DATA.unpack(data[: _SIDE_DATA.size])
        if not (has_colors and has_luminances) or not all(numbers[1::2]):
            return None
        values = [Fraction(*pair) for pair in zip(numbers[::2], numbers[1::2], strict=True)]
        red, green, blue, white = ((values[k], values[k + 1]) for k in range(0, 8, 2))
        return cls(red, green, blue, white, values[8], values[9])

    def integral(self) -> str:
        """As x264 and x265 read it, in the units of ITU-T H.265, D.3.28."""
        points = (("G", self.green), ("B", self.blue), ("R", self.red), ("WP", self.white))
        shown = (
            f"{name}({round(x * _CHROMATICITY_STEPS)},{round(y * _CHROMATICITY_STEPS)})" for name, (x, y) in points
        )
        return "".join(shown) + f"L({round(self.most * _LUMINANCE_STEPS)},{round(self.least * _LUMINANCE_STEPS)})"

    def decimal(self) -> str:
        """As SVT-AV1 reads it."""
        points = (("G", self.green), ("B", self.blue), ("R", self.red), ("WP", self.white))
        shown = (f"{name}({float(x):.5f},{float(y):.5f})" for name, (x, y) in points)
        return "".join(shown) + f"L({float(self.most):.4f},{float(self.least):.4f})"


@dataclass(frozen=True)
class ContentLight:
    """CTA-861.3: the brightest pixel and the brightest frame's average, in cd/m²; 0 is unknown."""

    max_content: int
    max_average: int

    @classmethod
    def of_side_data(cls, data: bytes) -> ContentLight | None:
        """Read libav's AVContentLightMetadata; None when it is too short."""
        return cls(*struct.unpack("=2I", data[:8])) if len(data) >= 8 else None
