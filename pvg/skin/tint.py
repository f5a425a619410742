"""Light whose colour is not the same over a face: a coloured lamp from one side, a window on the other.

The key frame's skin under such light has a hue of its own in every place, and would be taken for another thing's. What
the light adds is smooth: the logarithms of R/G and B/G of open skin are fitted by planes over the face, and what they
are tilted more than on the key frame is taken back before colours are looked up. Small tilts are the skin's own and
left alone.
"""

from __future__ import annotations

import numpy as np

from pvg._arrays import Bools, Bytes, Doubles, Floats, ramp
from pvg.skin.parameters import SKIN_PRIOR

_TINT = SKIN_PRIOR.tint


def tint_slopes(rgb: Bytes, sample: Bools, size: float) -> Doubles:
    """(2, 2) slopes along x and y of log R/G and log B/G over the open skin, a face size; 0 where too little is seen.

    rgb: (h, w, 3);  sample: (h, w), open skin;  size: of the face in cells. What stands in front of the face does not
    lie on the plane of the rest and does not count.
    """
    step = max(1, round(size / _TINT.cells))
    rows, columns = np.nonzero(sample[::step, ::step])
    if len(rows) < _TINT.least_cells:
        return np.zeros((2, 2))
    colors = rgb[::step, ::step][rows, columns].astype(np.float64)
    shown = (colors.max(axis=1) < _TINT.clipped) & (colors.max(axis=1) > _TINT.dark)
    if shown.sum() < _TINT.least_cells / 2:
        return np.zeros((2, 2))
    logs = np.log(colors[shown] + _TINT.dark)
    wanted = logs[:, (0, 2)] - logs[:, 1:2]
    places = np.stack([columns[shown], rows[shown]], axis=1) * (step / size)
    basis = np.column_stack([places - places.mean(axis=0), np.ones(len(places))])
    found = np.vstack([np.zeros((2, 2)), np.median(wanted, axis=0)])
    ridge = np.diag([_TINT.ridge * len(places)] * 2 + [0.0])
    for _ in range(_TINT.rounds):
        off = ((wanted - basis @ found) ** 2).sum(axis=1) / _TINT.outlier**2
        weighted = basis / (1.0 + off[:, None]) ** 2
        found = np.linalg.solve(weighted.T @ basis + ridge, weighted.T @ wanted)
    return np.asarray(found[:2].T)


def without_tilt(rgb: Bytes, slopes: Doubles, size: float) -> Bytes:
    """The picture (h, w, 3) with a tilt (2, 2) of the light's colour beyond the usual taken back, itself if none."""
    steep = np.hypot(*slopes.T)
    share = ramp(steep, *_TINT.tilt_rise)
    if not share.any():
        return rgb
    slopes = slopes * (share * np.minimum(1.0, _TINT.steepest / np.maximum(steep, 1e-9)))[:, None]
    h, w = rgb.shape[:2]
    x, y = ((np.arange(n) - (n - 1) / 2) / size for n in (w, h))
    out = rgb.astype(np.float32)
    for channel, (across, down) in zip((0, 2), slopes, strict=True):
        light: Floats = np.exp(-(across * x + down * y[:, None])).astype(np.float32)
        out[..., channel] *= light
    return np.asarray(np.clip(np.rint(out), 0, 255), np.uint8)
