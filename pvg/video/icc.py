"""Profiles of pictures: what their R, G, B stand for, by ICC.1:2022 (matrix and tone curves) or PNG's cICP.

Profiles of cameras, screens and editing suites for R, G, B are of that kind; those of printers and scanners are tables
and are not read here.
"""

from __future__ import annotations

import struct
from functools import lru_cache

import numpy as np

from pvg._arrays import Doubles
from pvg.video.color import SRGB, ColorSpace, Curve, Transfer, srgb_to_d50_xyz

_HEADER, _ENTRY, _MOST_TAGS = 128, 12, 200
_MOST_POINTS = 65536
_MOST_TAG_BYTES = 12 + 2 * _MOST_POINTS  # of a curve
_XYZ, _CURVES = ("rXYZ", "gXYZ", "bXYZ"), ("rTRC", "gTRC", "bTRC")
_ALIKE = 0.75  # levels: profiles nearer to sRGB than this are sRGB, whose values are taken as they are
_PARAMETERS = {0: 1, 1: 3, 2: 4, 3: 5, 4: 7}  # of parametric curves, by function type [ICC.1:2022, 10.18]


@lru_cache(maxsize=2)  # of a picture and a reference; a profile may have 16 MiB
def profile_space(profile: bytes) -> ColorSpace | None:
    """The space of an ICC profile; None when it is sRGB or as good as that.

    Raises `ValueError` in words for people when it is damaged, or not one of a matrix and tone curves for R, G, B.
    """
    try:
        tags = _tags(profile)
        matrix = np.stack([_xyz(tags[name]) for name in _XYZ], axis=1)
        name = "ICC profile"
        curves = tuple(_curve(tags[tag], name) for tag in _CURVES)
        to_srgb = np.asarray(np.linalg.solve(srgb_to_d50_xyz(), matrix), np.float64)
    except KeyError as error:
        raise ValueError(
            f"the colour profile has no {error.args[0]}: only profiles of a matrix and curves are read"
        ) from None
    except (struct.error, IndexError, np.linalg.LinAlgError) as error:
        raise ValueError("the colour profile is damaged") from error
    if not np.isfinite(to_srgb).all() or abs(np.linalg.det(to_srgb)) < 1e-3:
        raise ValueError("the colour profile is damaged")
    space = ColorSpace(name, (curves[0], curves[1], curves[2]), to_srgb, SRGB, matrix[1])
    corners = np.stack(np.meshgrid(*[np.linspace(0, 255, 6)] * 3), axis=-1).reshape(-1, 3)
    return None if np.abs(np.clip(space.to_sdr(corners), 0, 255) - corners).max() < _ALIKE else space


def _tags(profile: bytes) -> dict[str, bytes]:
    if len(profile) < _HEADER + 4 or profile[36:40] != b"acsp":
        raise ValueError("the colour profile is damaged")
    if profile[16:20] != b"RGB ":
        kind = profile[16:20].decode("ascii", "replace").strip()
        raise ValueError(f"the colour profile is one of {kind}, not of RGB")
    if profile[20:24] != b"XYZ ":
        raise ValueError("the colour profile is one of tables: only profiles of a matrix and curves are read")
    (count,) = struct.unpack_from(">I", profile, _HEADER)
    out = {}
    for k in range(min(count, _MOST_TAGS)):
        tag, offset, size = struct.unpack_from(">4sII", profile, _HEADER + 4 + k * _ENTRY)
        name = tag.decode("latin-1")
        if name in (*_XYZ, *_CURVES) and name not in out:  # each may claim all of the profile for itself
            out[name] = profile[offset : offset + min(size, _MOST_TAG_BYTES)]
    return out


def _xyz(data: bytes) -> Doubles:
    """An XYZType [10.31]."""
    return np.array(struct.unpack_from(">3i", data, 8), np.float64) / 65536.0


def _curve(data: bytes, name: str) -> Transfer:
    """A curveType [10.6] or parametricCurveType [10.18]."""
    if data[:4] == b"para":
        return _parametric(data, name)
    if data[:4] != b"curv":
        raise ValueError("the colour profile has a tone curve of a kind that is not read")
    (count,) = struct.unpack_from(">I", data, 8)
    if count == 0:
        return _tabled(np.array([0.0, 1.0]), name)
    if count == 1:
        (gamma,) = struct.unpack_from(">H", data, 12)
        return _sampled(lambda v: v ** (gamma / 256.0), name)
    if count > _MOST_POINTS:
        raise ValueError("the colour profile is damaged")
    return _tabled(np.array(struct.unpack_from(f">{count}H", data, 12), np.float64) / 65535.0, name)


def _parametric(data: bytes, name: str) -> Transfer:
    (kind,) = struct.unpack_from(">H", data, 8)
    if kind not in _PARAMETERS:
        raise ValueError("the colour profile has a tone curve of a kind that is not read")
    values = np.array(struct.unpack_from(f">{_PARAMETERS[kind]}i", data, 12), np.float64) / 65536.0
    g, a, b, c, d, e, f = np.concatenate([values, np.zeros(7 - len(values))])
    if kind == 0:
        return _sampled(lambda v: v**g, name)
    if kind in (1, 2):  # a power with an offset, flat below -b/a
        return _sampled(lambda v: np.maximum(a * v + b, 0.0) ** g + c, name)
    return _sampled(lambda v: np.where(v >= d, np.maximum(a * v + b, 0.0) ** g + e, c * v + f), name)


def _sampled(curve: Curve, name: str) -> Transfer:
    with np.errstate(all="ignore"):
        return _tabled(np.nan_to_num(np.asarray(curve(np.linspace(0.0, 1.0, 4096)), np.float64)), name)


def _tabled(values: Doubles, name: str) -> Transfer:
    """A tone curve by its values at even steps from 0 to 1, made increasing."""
    steps = np.linspace(0.0, 1.0, len(values))
    rising = np.maximum.accumulate(np.clip(values, 0.0, 1.0)) + 1e-9 * steps
    return Transfer(
        name,
        lambda signal: np.interp(signal, steps, rising),
        lambda light: np.interp(light, rising, steps),
    )
