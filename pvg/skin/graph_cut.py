"""Minimum cut: the mask that best agrees with log-odds a pixel while cutting along the picture's edges.

OpenCV's GrabCut holds a max-flow solver behind colour mixtures of its own. Frozen mixtures that differ in the first
channel only make it ours: with means ±m and one variance, their log-likelihood ratio is linear in that channel.
"""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Doubles, Floats
from pvg.skin.parameters import SKIN_PRIOR

_CUT = SKIN_PRIOR.cut
# how log-odds are written into a channel of 8 bits: nothing of it is tuned
_MIDDLE, _STEPS = 128.0, 2.0  # the value of log-odds 0, and steps a nat
_OFFSET = 10.0  # levels from there to the means of both mixtures
_BLIND = 1e6  # the variance of the channels that the mixtures do not look at


def minimum_cut(rgb: Bytes, log_odds: Floats) -> Bools:
    """Skin (h, w) bool for log-odds (h, w) over a picture (h, w, 3)."""
    lab = cv2.cvtColor(rgb, cv2.COLOR_RGB2LAB)
    channels = np.empty(rgb.shape, np.uint8)
    channels[..., 0] = np.rint(_MIDDLE + np.clip(log_odds, -_CUT.limit, _CUT.limit) * _STEPS)
    channels[..., 1] = lab[..., 0]
    channels[..., 2] = np.clip(128 + (lab[..., 1] - 128.0) * _CUT.chroma, 0, 255)
    variance = 2 * _OFFSET * _STEPS / _CUT.trust
    background, skin = _frozen_mixture(_MIDDLE - _OFFSET, variance), _frozen_mixture(_MIDDLE + _OFFSET, variance)
    labels = np.where(log_odds > 0, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[log_odds < -_CUT.certain] = cv2.GC_BGD
    labels[log_odds > _CUT.certain] = cv2.GC_FGD
    cv2.grabCut(channels, labels, (0, 0, 1, 1), background, skin, 1, cv2.GC_EVAL_FREEZE_MODEL)
    cut: Bools = (labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)
    return cut


def _frozen_mixture(mean: float, variance: float) -> Doubles:
    """A mixture (1, 65) of one Gaussian that looks at the first channel only: weights, means, covariances."""
    model = np.zeros((1, 65))
    model[0, 0] = 1
    model[0, 5:8] = (mean, 128, 128)
    model[0, 20:29] = np.diag([variance, _BLIND, _BLIND]).ravel()
    return model
