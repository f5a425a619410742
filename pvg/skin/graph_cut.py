"""Minimum cut: the mask that best agrees with log-odds a pixel while cutting along the picture's edges.

OpenCV's GrabCut holds a max-flow solver behind colour mixtures of its own. Frozen mixtures that differ in the first
channel only make it ours: with means ±m and one variance, their log-ratio is linear in that channel.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Bools, Bytes, Floats

_UNITS = 2.0  # steps of the first channel a nat of log-odds
_LIMIT = 10.0  # nats
_MIDDLE, _OFFSET = 128.0, 10.0
_CERTAIN = 6.5


def minimum_cut(rgb: Bytes, odds: Floats, *, trust: float = 14.0) -> Bools:
    """Skin (h, w) bool for log-odds (h, w) over a picture (h, w, 3).

    trust: relative weight of the log-odds; larger cuts follow the odds, smaller ones the picture's edges.
    """
    lab = cv2.cvtColor(rgb, cv2.COLOR_RGB2LAB)
    channels = np.empty(rgb.shape, np.uint8)
    channels[..., 0] = np.rint(_MIDDLE + np.clip(odds, -_LIMIT, _LIMIT) * _UNITS)
    channels[..., 1] = lab[..., 0]
    channels[..., 2] = np.clip(128 + (lab[..., 1] - 128.0) * 1.5, 0, 255)
    variance = 2 * _OFFSET * _UNITS / trust
    background, skin = _frozen(_MIDDLE - _OFFSET, variance), _frozen(_MIDDLE + _OFFSET, variance)
    labels = np.where(odds > 0, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[odds < -_CERTAIN] = cv2.GC_BGD
    labels[odds > _CERTAIN] = cv2.GC_FGD
    cv2.grabCut(channels, labels, (0, 0, 1, 1), background, skin, 1, cv2.GC_EVAL_FREEZE_MODEL)
    cut: Bools = (labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)
    return cut


def _frozen(mean: float, variance: float) -> NDArray[np.float64]:
    """A mixture (1, 65) of one Gaussian that looks at the first channel only: weights, means, covariances."""
    model = np.zeros((1, 65))
    model[0, 0] = 1
    model[0, 5:8] = (mean, 128, 128)
    model[0, 20:29] = np.diag([variance, 1e6, 1e6]).ravel()
    return model
