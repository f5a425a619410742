"""The measures themselves, on arrays; what each means and its target: ../README.md and docs/method.md."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.quality.color import delta_e_2000
from benchmarks.quality.faces import Bools, Floats, Image, sample_pixels
from pvg.looks import sliced_wasserstein

_LEAST_MSE = 1e-4  # identical pictures count as 88 dB, not infinity
_CONSISTENT_PX = 0.5
_CONSISTENT_SHARE = 0.05  # of the displacement
_COLOR_SAMPLE = 2000
_PROJECTIONS = 32


def psnr(first: Image, second: Image, where: Bools | None = None) -> float:
    """Peak signal-to-noise ratio in dB of two uint8 pictures, over all pixels or over a bool mask of them."""
    if where is None:
        error = cv2.norm(first, second, cv2.NORM_L2SQR) / first.size
    else:
        error = float(np.mean((first[where].astype(np.float32) - second[where]) ** 2))
    return float(10.0 * np.log10(255.0**2 / max(error, _LEAST_MSE)))


def less_running_mean(values: Sequence[float], breaks: Sequence[bool], window: int) -> Floats:
    """Values less their mean over `window` neighbours, centred, shorter at the ends: what flickers, not what moves.

    breaks: whether a value begins a new run, after a cut or a gap; no mean reaches over it.
    """
    series = np.asarray(values, np.float64)
    starts = [0, *(i for i, new in enumerate(breaks) if new and i > 0), len(series)]
    out = np.empty_like(series)
    half = window // 2
    for start, stop in itertools.pairwise(starts):
        sums = np.concatenate([[0.0], np.cumsum(series[start:stop])])
        at = np.arange(stop - start)
        low, high = np.maximum(at - half, 0), np.minimum(at + half + 1, stop - start)
        out[start:stop] = series[start:stop] - (sums[high] - sums[low]) / (high - low)
    return out.astype(np.float32)


@dataclass(frozen=True, eq=False)
class Motion:
    """How one frame's pixels come from those of the frame before.

    flow: (h, w, 2) float32, where each pixel was, relative to where it is;  certain: (h, w) bool, whether forward and
    backward flow agree and the pixel was in the picture.
    """

    flow: Floats
    certain: Bools

    def warp(self, before: Image | Floats) -> Floats:
        """The frame before, brought to where its pixels are now: (h, w, 3) float32."""
        h, w = self.flow.shape[:2]
        x, y = np.meshgrid(np.arange(w, dtype=np.float32), np.arange(h, dtype=np.float32))
        moved = cv2.remap(
            before.astype(np.float32),
            x + self.flow[..., 0],
            y + self.flow[..., 1],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        return np.asarray(moved, np.float32)


def motion(before: Image, now: Image) -> Motion:
    """Dense optical flow between two RGB pictures (h, w, 3), checked both ways."""
    finder = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    grey_before, grey_now = (cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) for picture in (before, now))
    start = (*grey_now.shape, 2)  # each its own: the finder starts from what it is given and writes into it
    back = np.asarray(finder.calc(grey_now, grey_before, np.zeros(start, np.float32)), np.float32)
    forth = np.asarray(finder.calc(grey_before, grey_now, np.zeros(start, np.float32)), np.float32)
    h, w = back.shape[:2]
    x, y = np.meshgrid(np.arange(w, dtype=np.float32), np.arange(h, dtype=np.float32))
    was_x, was_y = x + back[..., 0], y + back[..., 1]
    returned = cv2.remap(forth, was_x, was_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    miss = np.hypot(*np.moveaxis(back + returned, -1, 0))
    inside = (was_x >= 0) & (was_y >= 0) & (was_x <= w - 1) & (was_y <= h - 1)
    certain = inside & (miss < _CONSISTENT_PX + _CONSISTENT_SHARE * np.hypot(back[..., 0], back[..., 1]))
    return Motion(back, certain)


def warping_errors(before: Image, now: Image, moved: Motion, places: Sequence[Bools | None]) -> list[float]:
    """Mean squared difference of a frame and the warped frame before, over each of `places` (bool masks, None for the
    whole picture) where the flow is certain; NaN where it nowhere is."""
    squares = np.mean((now.astype(np.float32) - moved.warp(before)) ** 2, axis=2)
    used = [moved.certain if where is None else where & moved.certain for where in places]
    return [float(squares[where].mean()) if where.any() else float("nan") for where in used]


def detail_kept(source: Floats, result: Floats, where: Bools) -> float:
    """Correlation of the Laplacians of two luma planes (h, w) float32 over `where`."""
    first, second = (cv2.Laplacian(plane, cv2.CV_32F)[where] for plane in (source, result))
    if first.size < 2 or first.std() == 0.0 or second.std() == 0.0:
        return float("nan")
    return float(np.corrcoef(first, second)[0, 1])


def color_distance(pixels: Any, wanted: Any) -> float:
    """Sliced Wasserstein distance of two pixel sets (n, 3) in levels, on the same seeded draw and directions."""
    first, second = (sample_pixels(np.asarray(part), _COLOR_SAMPLE) for part in (pixels, wanted))
    return sliced_wasserstein(first, second, rng=np.random.default_rng(0), projections=_PROJECTIONS)


def median_delta_e(pixels: Any, median: Any) -> float:
    """CIEDE2000 of the median colour of pixels (n, 3) to a colour (3,)."""
    return delta_e_2000(np.median(pixels, axis=0), median)


def iou(first: Bools, second: Bools) -> float:
    """Intersection over union; 1 for two empty masks."""
    union = int((first | second).sum())
    return float((first & second).sum() / union) if union else 1.0


def wander(means: NDArray[np.float64]) -> float:
    """Standard deviation over frames of mean colours (frames, 3), averaged over the channels."""
    return float(np.std(means, axis=0).mean())
