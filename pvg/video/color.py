"""Colour of the source: from a clip's own R'G'B' to SDR-referred BT.709 values and back.

Landmarks, skin and transport look at faces as an SDR display would show them. Most clips are just that; their values
are taken as they are. HDR, wide gamut, camera logarithms and pictures with a profile have a `ColorSpace`: what is
looked at goes through it, and only boundary colours come back. The pixels themselves are never converted.

    own R'G'B'  → transfer →  light, 1 = SDR white  → matrix →  BT.709 light  → display →  SDR R'G'B'

Code points are those of ISO/IEC 23091-2 (H.273). PQ: SMPTE ST 2084; HLG: ITU-R BT.2100, shown at 1000 cd/m²; SDR white
stands at 203 cd/m² in both (ITU-R BT.2408) and SDR is shown by ITU-R BT.1886.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Literal, get_args

import numpy as np

from pvg._arrays import Doubles, Floats
from pvg.errors import MediaError
from pvg.video._kernels import DisplayTables

Curve = Callable[[Doubles], Doubles]
"""Of values (…), elementwise: signals in [0, 1] to light, 1 = SDR white, or back."""

REFERENCE_WHITE = 203.0  # cd/m² of SDR white in PQ and HLG [BT.2408]
TABLE = 4096  # entries of the tables pictures are converted by

_PQ_PEAK = 10_000.0
_HLG_PEAK, _HLG_GAMMA = 1000.0, 1.2  # nominal display of BT.2100
_D65 = (0.3127, 0.3290)


@dataclass(frozen=True)
class Transfer:
    """A transfer function: `decode` signals in [0, 1] to light, `encode` back; both increasing, elementwise.

    system_gamma: of the luminance after decoding, 1 for all but HLG.
    """

    name: str
    decode: Curve
    encode: Curve
    system_gamma: float = 1.0


def _power(gamma: float, name: str) -> Transfer:
    """Light as a power of the signal, as BT.1886 is with 2.4."""
    return Transfer(name, lambda v: np.maximum(v, 0.0) ** gamma, lambda light: np.maximum(light, 0.0) ** (1 / gamma))


def _pq_decode(signal: Doubles) -> Doubles:
    """The EOTF of SMPTE ST 2084, in units of `REFERENCE_WHITE`."""
    m1, m2, c1, c2, c3 = 2610 / 16384, 2523 / 32, 3424 / 4096, 2413 / 128, 2392 / 128
    power = np.clip(signal, 0.0, 1.0) ** (1 / m2)
    return np.asarray((np.maximum(power - c1, 0.0) / (c2 - c3 * power)) ** (1 / m1) * (_PQ_PEAK / REFERENCE_WHITE))


def _pq_encode(light: Doubles) -> Doubles:
    """The inverse EOTF of SMPTE ST 2084."""
    m1, m2, c1, c2, c3 = 2610 / 16384, 2523 / 32, 3424 / 4096, 2413 / 128, 2392 / 128
    power = np.clip(light * (REFERENCE_WHITE / _PQ_PEAK), 0.0, 1.0) ** m1
    return np.asarray(((c1 + c2 * power) / (1.0 + c3 * power)) ** m2)


_HLG_A = 0.17883277
_HLG_B, _HLG_C = 1.0 - 4.0 * _HLG_A, 0.5 - _HLG_A * float(np.log(4.0 * _HLG_A))
_HLG_SCALE = (_HLG_PEAK / REFERENCE_WHITE) ** (1.0 / _HLG_GAMMA)  # so that SDR white is 1 after the system gamma


def _hlg_decode(signal: Doubles) -> Doubles:
    """The inverse OETF of ITU-R BT.2100, table 5; the system gamma comes after it."""
    signal = np.maximum(signal, 0.0)
    light = np.where(signal <= 0.5, signal**2 / 3.0, (np.exp((signal - _HLG_C) / _HLG_A) + _HLG_B) / 12.0)
    return np.asarray(light * _HLG_SCALE)


def _hlg_encode(light: Doubles) -> Doubles:
    """The OETF of ITU-R BT.2100, table 5."""
    light = np.maximum(light, 0.0) / _HLG_SCALE
    high = _HLG_A * np.log(np.maximum(12.0 * light - _HLG_B, 1e-9)) + _HLG_C
    return np.asarray(np.where(light <= 1.0 / 12.0, np.sqrt(3.0 * light), high))


def _srgb_decode(signal: Doubles) -> Doubles:
    """IEC 61966-2-1."""
    signal = np.maximum(signal, 0.0)
    return np.asarray(np.where(signal <= 0.04045, signal / 12.92, ((signal + 0.055) / 1.055) ** 2.4))


def _srgb_encode(light: Doubles) -> Doubles:
    """The inverse, IEC 61966-2-1."""
    light = np.maximum(light, 0.0)
    return np.asarray(np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055))


def _camera_decode(signal: Doubles) -> Doubles:
    """The inverse OETF of ITU-R BT.709."""
    signal = np.maximum(signal, 0.0)
    return np.asarray(np.where(signal < 0.081, signal / 4.5, ((signal + 0.099) / 1.099) ** (1 / 0.45)))


def _camera_encode(light: Doubles) -> Doubles:
    """The OETF of ITU-R BT.709."""
    light = np.maximum(light, 0.0)
    return np.asarray(np.where(light < 0.018, 4.5 * light, 1.099 * light**0.45 - 0.099))


def _logarithmic(name: str, cut: float, low: tuple[float, float], high: tuple[float, ...], *, codes: bool) -> Transfer:
    """signal = low[0]·x + low[1] below `cut`, else high[0]·log10(high[1]·x + high[2]) + high[3].

    codes: whether the formula gives 10-bit code values over 1023, of which the studio range has 64 to 940, rather
    than the share of that range.
    """
    c, a, b, d = high
    (slope, start), at_cut = low, c * np.log10(a * cut + b) + d

    def own(signal: Doubles) -> Doubles:
        return np.asarray((64.0 + 876.0 * signal) / 1023.0 if codes else signal)

    def decode(signal: Doubles) -> Doubles:
        value = own(np.asarray(signal, np.float64))
        return np.asarray(np.where(value < at_cut, (value - start) / slope, (10.0 ** ((value - d) / c) - b) / a))

    def encode(light: Doubles) -> Doubles:
        value = np.where(light < cut, slope * light + start, c * np.log10(np.maximum(a * light + b, 1e-9)) + d)
        return np.asarray((1023.0 * value - 64.0) / 876.0 if codes else value)

    return Transfer(name, decode, encode)


def _apple_log() -> Transfer:
    """By Apple's published formula: a square below the cut, a logarithm above."""
    zero, cut, c = -0.05641088, 0.01, 47.28711236
    beta, gamma, delta = 0.00964052, 0.08550479, 0.69336945
    at_cut = c * (cut - zero) ** 2

    def decode(signal: Doubles) -> Doubles:
        low = np.sqrt(np.maximum(signal, 0.0) / c) + zero
        return np.asarray(np.where(signal < at_cut, low, 2.0 ** ((signal - delta) / gamma) - beta))

    def encode(light: Doubles) -> Doubles:
        high = gamma * np.log2(np.maximum(light + beta, 1e-9)) + delta
        return np.asarray(np.where(light < cut, c * np.maximum(light - zero, 0.0) ** 2, high))

    return Transfer("Apple Log", decode, encode)


def _logc4() -> Transfer:
    """By ARRI's published formula: a line below `t`, a logarithm above."""
    a, b, c = (2.0**18 - 16.0) / 117.45, (1023.0 - 95.0) / 1023.0, 95.0 / 1023.0
    s = 7.0 * np.log(2.0) * 2.0 ** (7.0 - 14.0 * c / b) / (a * b)
    t = (2.0 ** (14.0 * (-c / b) + 6.0) - 64.0) / a
    return Transfer(
        "LogC4",
        lambda v: np.where(v < 0.0, v * s + t, (2.0 ** (14.0 * (v - c) / b + 6.0) - 64.0) / a),
        lambda x: np.where(x < t, (x - t) / s, (np.log2(np.maximum(a * x + 64.0, 1e-9)) - 6.0) / 14.0 * b + c),
    )


_BT1886, _GAMMA_22, _GAMMA_28 = _power(2.4, "BT.1886"), _power(2.2, "gamma 2.2"), _power(2.8, "gamma 2.8")
_LINEAR = _power(1.0, "linear light")
SRGB = Transfer("sRGB", _srgb_decode, _srgb_encode)
_CAMERA = Transfer("BT.709 camera", _camera_decode, _camera_encode)
_PQ = Transfer("PQ", _pq_decode, _pq_encode)
_HLG = Transfer("HLG", _hlg_decode, _hlg_encode, _HLG_GAMMA)

_TRANSFERS = {  # H.273 TransferCharacteristics; what SDR displays show alike is one
    **dict.fromkeys((1, 2, 6, 7, 11, 12, 14, 15), _BT1886),
    **{4: _GAMMA_22, 5: _GAMMA_28, 8: _LINEAR, 13: SRGB, 16: _PQ, 18: _HLG},
}
_AS_SHOWN = (1, 2, 4, 5, 6, 7, 11, 12, 13, 14, 15)  # with BT.709 primaries shown as they are, as players do
_PRIMARIES = {  # H.273 ColourPrimaries: x, y of red, green and blue; white is D65
    **dict.fromkeys((1, 2, 4, 5, 6, 7), ((0.640, 0.330), (0.300, 0.600), (0.150, 0.060))),  # players show all as BT.709
    9: ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046)),  # BT.2020
    **dict.fromkeys((11, 12), ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060))),  # P3, that of cinemas read as D65
}

_LOG_FOOTAGE = {  # name -> (transfer, primaries); by their makers' published formulas
    "slog3": (  # Sony S-Log3, S-Gamut3.Cine
        _logarithmic(
            "S-Log3",
            0.01125,
            (76.2102946929 / 0.01125 / 1023.0, 95.0 / 1023.0),
            (261.5 / 1023.0, 1.0 / 0.19, 0.01 / 0.19, 420.0 / 1023.0),
            codes=True,
        ),
        ((0.766, 0.275), (0.225, 0.800), (0.089, -0.087)),
    ),
    "logc3": (  # ARRI LogC3 at EI 800, ARRI Wide Gamut 3
        _logarithmic(
            "LogC3",
            0.010591,
            (5.367655, 0.092809),
            (0.247190, 5.555556, 0.052272, 0.385537),
            codes=False,
        ),
        ((0.6840, 0.3130), (0.2210, 0.8480), (0.0861, -0.1020)),
    ),
    "logc4": (_logc4(), ((0.7347, 0.2653), (0.1424, 0.8576), (0.0991, -0.0308))),  # ARRI Wide Gamut 4
    "vlog": (  # Panasonic V-Log, V-Gamut
        _logarithmic("V-Log", 0.01, (5.6, 0.125), (0.241514, 1.0, 0.00873, 0.598206), codes=True),
        ((0.730, 0.280), (0.165, 0.840), (0.100, -0.030)),
    ),
    "applelog": (_apple_log(), _PRIMARIES[9]),
}
InputColor = Literal["auto", "sdr", "pq", "hlg", "slog3", "logc3", "logc4", "vlog", "applelog"]
INPUT_COLORS = get_args(InputColor)
"""What a caller may say of a clip's colours: "auto" believes its tags."""


def _to_xyz(primaries: tuple[tuple[float, float], ...]) -> Doubles:
    """(3, 3) R, G, B light of these primaries, whose white is D65, as CIE XYZ, white's Y being 1."""
    columns = np.array([[x / y, 1.0, (1.0 - x - y) / y] for x, y in primaries]).T
    x, y = _D65
    return np.asarray(columns * np.linalg.solve(columns, np.array([x / y, 1.0, (1.0 - x - y) / y])))


def srgb_to_d50_xyz() -> Doubles:
    """(3, 3) sRGB light as CIE XYZ seen under D50, as ICC profiles count, by the Bradford adaptation."""
    bradford = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
    d65, d50 = np.array([0.95047, 1.0, 1.08883]), np.array([0.9642, 1.0, 0.8249])
    adapt = np.linalg.solve(bradford, np.diag((bradford @ d50) / (bradford @ d65)) @ bradford)
    return np.asarray(adapt @ _to_xyz(_PRIMARIES[1]))


@dataclass(frozen=True, eq=False)
class ColorSpace:
    """How a clip's own R'G'B' becomes SDR-referred BT.709 R'G'B' and back; see the module.

    name: for people;  transfers: of red, green and blue;  matrix: (3, 3) from own light to BT.709's;
    display: what SDR light is coded by;  weights: (3,) luminance of own light, for a system gamma.
    Equal spaces are one object: `color_space` keeps them.
    """

    name: str
    transfers: tuple[Transfer, Transfer, Transfer]
    matrix: Doubles
    display: Transfer
    weights: Doubles

    def to_sdr(self, colors: Doubles | Floats) -> Doubles:
        """Own R'G'B' (n, 3), 0-255, as SDR-referred BT.709 R'G'B', 0-255; brighter than SDR white is above 255."""
        signal = np.asarray(colors, np.float64) / 255.0
        light = np.stack([curve.decode(signal[:, k]) for k, curve in enumerate(self.transfers)], axis=1)
        gamma = self.transfers[0].system_gamma
        if gamma != 1.0:
            light = light * np.maximum(light @ self.weights, 0.0)[:, None] ** (gamma - 1.0)
        return np.asarray(self.display.encode(light @ self.matrix.T) * 255.0)

    def from_sdr(self, colors: Doubles | Floats) -> Doubles:
        """The inverse of `to_sdr`, for colours (n, 3) from 0 on; what the space cannot hold goes to its nearest end."""
        light = self.display.decode(np.asarray(colors, np.float64) / 255.0) @ np.linalg.inv(self.matrix).T
        light = np.maximum(light, 0.0)
        gamma = self.transfers[0].system_gamma
        if gamma != 1.0:
            luminance = np.maximum(light @ self.weights, 1e-9)[:, None]
            light = light * luminance ** (1.0 / gamma - 1.0)
        signal = np.stack([curve.encode(light[:, k]) for k, curve in enumerate(self.transfers)], axis=1)
        return np.asarray(np.clip(signal, 0.0, 1.0) * 255.0)

    def slope(self, luma: Doubles | Floats) -> Doubles:
        """How many own levels a level of SDR grey makes at grey levels (n,), 0-255."""
        grey = np.clip(np.asarray(luma, np.float64), 2.0, 253.0)[:, None]
        ends = (self.from_sdr(np.repeat(grey + step, 3, axis=1))[:, 1] for step in (1.0, -1.0))
        above, below = ends
        return np.asarray((above - below) / 2.0)

    @cached_property
    def tables(self) -> DisplayTables:
        """What `_kernels.codes_to_sdr` reads."""
        steps = np.linspace(0.0, 1.0, TABLE)
        light = np.stack([curve.decode(steps) for curve in self.transfers])
        gamma = self.transfers[0].system_gamma
        raised = np.maximum(steps**2, 1e-9) ** (gamma - 1.0)
        shown = self.display.encode(steps**2) * 255.0
        return DisplayTables(
            light=light.astype(np.float32),
            raised=raised.astype(np.float32),
            weights=self.weights.astype(np.float32),
            gamut=self.matrix.astype(np.float32),
            shown=shown.astype(np.float32),
        )


@cache
def color_space(primaries: int, transfer: int) -> ColorSpace | None:
    """The space of H.273 code points; None for SDR whose values are taken as they are.

    Raises `MediaError` for code points that no display here knows.
    """
    if transfer not in _TRANSFERS:
        raise MediaError(f"transfer function {transfer} (ISO/IEC 23091-2) is not supported; re-encode as BT.709")
    if primaries not in _PRIMARIES:
        raise MediaError(f"colour primaries {primaries} (ISO/IEC 23091-2) are not supported; re-encode as BT.709")
    wide = _PRIMARIES[primaries] != _PRIMARIES[1]
    if transfer in (16, 18) and primaries == 2:  # HDR without primaries is BT.2020
        return color_space(9, transfer)
    if not wide and transfer in _AS_SHOWN:
        return None
    curve = _TRANSFERS[transfer]
    name = curve.name + (" BT.2020" if primaries == 9 else " P3" if wide else "")
    # so that within BT.709 primaries SDR values would stay what they are
    display = curve if transfer in _AS_SHOWN else _BT1886
    return _space(name, curve, _PRIMARIES[primaries], display)


@cache
def named_space(name: str) -> ColorSpace | None:
    """The space of one of `INPUT_COLORS` but "auto"; None for "sdr". Raises `ValueError` for others."""
    if name == "sdr":
        return None
    if name in ("pq", "hlg"):
        return color_space(9, 16 if name == "pq" else 18)
    if name not in _LOG_FOOTAGE:
        raise ValueError(f"input color {name!r} is not one of {', '.join(INPUT_COLORS)}")
    curve, primaries = _LOG_FOOTAGE[name]
    return _space(curve.name, curve, primaries, _CAMERA)


def _space(name: str, curve: Transfer, primaries: tuple[tuple[float, float], ...], display: Transfer) -> ColorSpace:
    to_xyz = _to_xyz(primaries)
    matrix = np.asarray(np.linalg.solve(_to_xyz(_PRIMARIES[1]), to_xyz), np.float64)
    return ColorSpace(name, (curve, curve, curve), matrix, display, to_xyz[1])
