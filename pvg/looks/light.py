"""Where the light comes from: no map of colours carries it, so it is carried as a smooth ratio over the face.

Shading of a matt face is a low-order function of where its skin looks, second-order spherical harmonics of the normal
(Basri and Jacobs 2003; Ramamoorthi and Hanrahan 2001). It is fitted to the logarithm of luma of the open skin,
whose normals are known from the fitted mesh; the reference's shading over the clip's own is the ratio.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Doubles, Floats
from pvg.asset import KeyFrame
from pvg.curves import BOUNDARY, table_labels
from pvg.face import PARTS, layout
from pvg.looks.opponent import luma_of

_SAMPLES_ENOUGH = 60
_RIDGE = 0.004  # of the samples' number: keeps directions that are not seen from running away
_RANGE = (0.55, 1.8)  # of the ratio [by eye]
_BOUNDARY_AZIMUTH = 65.0  # where the mask boundary lies sideways: light there goes no further than on the cheeks
_STEEPEST = 65.0  # degrees from the front that the ratio changes up to
_ROBUST_ROUNDS = 4
_CURVES = {  # nearest to each part
    "lips": ("lips_outer", "lips_inner"),
    "lids": ("eye_left", "eye_right"),
    "cheeks": ("cheek_left", "cheek_right"),
    "brows": ("brow_left", "brow_right"),
}
_DARKEST = 4.0  # levels of luma below which a logarithm says nothing
_OUTLIER = 0.15  # of log luma: stubble, freckles, highlights count less


@cache
def _harmonics() -> Doubles:
    """(S, 9) second-order spherical harmonics, up to factors, of the skin's normal at every sample of the table."""
    labels = table_labels()
    on_landmarks = [labels.basis @ angles for angles in (layout.AZIMUTH_DEG, layout.ELEVATION_DEG)]
    around = 2 * np.pi * labels.s[labels.curve == BOUNDARY]  # an angle from the chin
    boundary = _BOUNDARY_AZIMUTH * np.sin(around), np.where(np.cos(around) > 0, 30.0, 20.0) * np.cos(around)
    azimuth, elevation = (
        np.radians(np.clip(np.concatenate(both), -_STEEPEST, _STEEPEST))
        for both in zip(on_landmarks, boundary, strict=True)
    )
    x, y, z = np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)
    terms = [np.ones_like(x), x, y, z, x * y, x * z, y * z, x * x - y * y, 3 * z * z - 1]
    return np.asarray(np.stack(terms, axis=1), np.float64)


def shading(key: KeyFrame) -> Doubles | None:
    """(9,) coefficients of the logarithm of luma of the open skin over its normals; None when too little is seen.

    The fit is robust: what is unlike its surroundings, as stubble is, counts less.
    """
    if len(key.skin) < _SAMPLES_ENOUGH:
        return None
    basis = _harmonics()[key.skin_at]
    wanted = np.log(np.maximum(luma_of(key.skin), _DARKEST))
    weight = np.ones(len(wanted))
    ridge = _RIDGE * len(wanted) * np.diag([0.0] + [1.0] * 8)
    for _ in range(_ROBUST_ROUNDS):
        found = np.linalg.solve((basis * weight[:, None]).T @ basis + ridge, (basis * weight[:, None]).T @ wanted)
        weight = 1.0 / (1.0 + ((basis @ found - wanted) / _OUTLIER) ** 2)
    return np.asarray(found)


def light_ratio(key: KeyFrame, reference: KeyFrame, strength: float) -> Floats:
    """(S,) float32 to multiply the boundary colours of `key` with, so that light falls as on the reference.

    strength: in [0, 1], 0 gives 1 everywhere. Brightness and contrast are left to the map of colours, which is made
    from the face in its new light.
    """
    ones = np.ones(len(key.colors), np.float32)
    if strength == 0.0:
        return ones
    ours, theirs = shading(key), shading(reference)
    if ours is None or theirs is None:
        return ones
    change = _harmonics() @ (theirs - ours)
    change -= np.median(change[key.skin_at])
    return np.asarray(np.exp(strength * np.clip(change, *np.log(_RANGE))), np.float32)


def relit(key: KeyFrame, ratio: Floats) -> KeyFrame:
    """The key frame with its colours multiplied by a ratio (S,) at the curves."""
    if (ratio == 1.0).all():
        return key
    colors, skin = key.colors * ratio[:, None], key.skin * ratio[key.skin_at][:, None]
    parts = key.parts * np.array([[ratio[on].mean()] for on in _around_parts()])
    return replace(key, colors=colors.astype(np.float32), skin=skin.astype(np.float32), parts=parts.astype(np.float32))


@cache
def _around_parts() -> tuple[NDArray[np.intp], ...]:
    """The samples of the table on or beside each of PARTS, whose light it stands in."""
    return tuple(np.flatnonzero(table_labels().on_curves(*_CURVES[part])) for part in PARTS)
