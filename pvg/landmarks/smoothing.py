"""Take the jitter out of a track without lag: shrink its small fast movements, keep the large ones whole.

Each coordinate's history is split into bands by repeated symmetric smoothing (the undecimated B3-spline transform):
x = d_0 + d_1 + d_2 + a_3, details and an approximation, exactly. Where a band's local energy is that of the jitter it
is removed; where it is well above, as in speech, a blink or a nod, it stays untouched. All filters are symmetric, so
nothing is delayed, and bands of a steady drift are zero, so a turning head is not held back.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from pvg._arrays import Doubles, smoothstep
from pvg.face import Landmarks
from pvg.landmarks.tracks import FaceTrack, fill_gaps

BANDS = 3
JITTER_CAP = 0.001
JITTER_CAP_PX = 0.1
"""Highest rms of one band that can be jitter: a share of the face's width, and a part that does not shrink with it.
[measured on clips of 190–250 px wide faces: 0.0003–0.0006 while still, five times that while they speak]"""
QUIET_QUANTILE, QUIET_TO_MEAN = 25, 1.6
"""Jitter never stops and movement does: the jitter's energy is read off the quieter frames, times what makes the
quantile of jitter alone its mean."""
JITTER_FLOOR = 0.05
"""Lowest rms of a band that is taken for jitter, as a share of the highest."""
POSE_CAP_DEG = 0.6
REMOVED_BELOW, KEPT_ABOVE = 2.0, 6.0
"""A band's energy over the jitter's: gone below the first, whole above the second."""
NEIGHBOURHOOD = 0.05
"""Spatial scale over which points share their energy, as a share of the face's width: half an eye."""

_NEIGHBOURS_END = 4.0  # spatial scales: what lies farther weighs less than 4e-4 of the point itself

_KERNEL = np.array([1, 4, 6, 4, 1]) / 16


def smooth(track: FaceTrack) -> FaceTrack:
    """Return the track with landmarks and pose smoothed in time; its frames and scores are unchanged.

    Stretches between gaps (score 0) are smoothed on their own and the gaps interpolated anew.
    """
    seen = np.flatnonzero(track.score > 0)
    runs = np.split(seen, np.flatnonzero(np.diff(seen) > 1) + 1)
    points = track.landmarks.stacked.astype(np.float64)
    pose = track.pose.astype(np.float64)[:, :, None]
    width = track.width_px
    cap = float(np.hypot(JITTER_CAP * width, JITTER_CAP_PX))
    for run in runs:
        points[run] = smooth_run(points[run], _sharing(points[run], width), cap)
        pose[run] = smooth_run(pose[run], sparse.eye_array(3, format="csr"), POSE_CAP_DEG)
    every = np.arange(len(track.score))
    filled = fill_gaps(points[seen].astype(np.float32), seen, every)
    return replace(
        track,
        landmarks=Landmarks.unstack(filled),
        pose=fill_gaps(pose[seen, :, 0].astype(np.float32), seen, every),
    )


def smooth_run(values: Doubles, sharing: sparse.csr_array, cap: float) -> Doubles:
    """Smooth values (n, p, k) over n consecutive frames; sharing (p, p) averages energy over like points.

    cap: the highest rms of a band that counts as jitter, in the unit of values.
    """
    approximation, kept, share = values, np.zeros_like(values), np.zeros(values.shape[:2])
    for band in range(BANDS):
        step = 1 << band
        smoother = _filtered(approximation, step, odd=True)
        detail = approximation - smoother
        # share only grows: a movement seen in a finer band is kept in the coarser ones too, where its tail is small
        own = _filtered((detail * detail).mean(axis=2), step, odd=False)
        # neighbours moving together raise the odds that a small movement is real; one point may also move alone
        share = np.maximum.reduce([share, _kept_share(own, cap), _kept_share(np.asarray((sharing @ own.T).T), cap)])
        kept += detail * share[:, :, None]
        approximation = smoother
    return approximation + kept


def _kept_share(energy: Doubles, cap: float) -> Doubles:
    """How much of a band to keep, in [0, 1], from its local energy (n, p)."""
    quiet = QUIET_TO_MEAN * np.percentile(energy, QUIET_QUANTILE, axis=0)
    jitter = np.clip(quiet, (JITTER_FLOOR * cap) ** 2, cap**2)
    return smoothstep(energy / jitter, REMOVED_BELOW, KEPT_ABOVE)


def _sharing(points: Doubles, width: float) -> sparse.csr_array:
    """(p, p) row-stochastic weights of the points near each point on the face's median shape."""
    shape = np.median(points - points.mean(axis=1, keepdims=True), axis=0) / width
    distance2 = (shape[:, None, 0] - shape[:, 0]) ** 2 + (shape[:, None, 1] - shape[:, 1]) ** 2
    weights = np.exp(-distance2 / (2 * NEIGHBOURHOOD**2)) * (distance2 < (_NEIGHBOURS_END * NEIGHBOURHOOD) ** 2)
    return sparse.csr_array(weights / weights.sum(axis=1, keepdims=True))


def _filtered(values: Doubles, step: int, *, odd: bool) -> Doubles:
    """Filter (n, …) along time with the spline kernel spread by step.

    The ends are continued by reflection, odd (through the end value, so that straight lines stay straight) or even.
    """
    count, reach = len(values), 2 * step
    index = np.arange(-reach, count + reach)
    period = max(2 * (count - 1), 1)
    folded = index % period
    folded = np.where(folded < count, folded, period - folded)
    padded = values[folded]
    if odd:
        # the difference to the end value changes sign on the far side of it
        beyond = np.minimum(index, 0) + np.maximum(index - (count - 1), 0)
        near_end = np.where((beyond < 0).reshape(-1, *[1] * (values.ndim - 1)), values[0], values[-1])
        outside = (beyond != 0).reshape(-1, *[1] * (values.ndim - 1))
        padded = np.where(outside, 2 * near_end - padded, padded)
    return np.asarray(sum(weight * padded[tap * step : tap * step + count] for tap, weight in enumerate(_KERNEL)))
