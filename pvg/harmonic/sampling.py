"""The pixels that the least squares of eq. (3) see, and how far each is to be trusted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Bools, Doubles, ramp
from pvg.harmonic.quadtree import Quadtree
from pvg.picture import LUMA

# A highlight, compared with the median of its cell:
_BRIGHTER = (2.0, 3.5)  # by so many spreads of luma: suspicion begins, is complete [by eye]
_LEAST_SPREAD = 4.0  # levels; an even cell has noise at least [by eye]
_PALER = 0.75  # of the cell's saturation at most [by eye]
_CLIPPED = 250.0  # levels in all three channels, whatever the saturation [by eye]
_LEAST_TRUST = 1e-3  # never 0: a face that is all highlight still has a colour [by eye]
_QUARTILES_A_SPREAD = 1.349  # distance of the quartiles of a normal distribution in standard deviations [derived]


@dataclass(frozen=True)
class Sample:
    """Pixels of the domain.

    Attributes:
        points: (n, 2) float64, (x, y) in pixels.
        colors: (n, 3) float64, RGB 0–255.
    """

    points: Doubles
    colors: Doubles


def draw_sample(image: NDArray[Any], domain: Bools, tree: Quadtree, samples: int, rng: np.random.Generator) -> Sample:
    """Pixels drawn without repetition from the domain, every leaf alike; all of them if there are no more.

    An even draw over the pixels would leave most of the fine leaves at the curves, where g is read, without data.

    Args:
        image: (H, W, 3), RGB 0–255.
        domain: (H, W) bool, with at least one pixel set.
        tree: leaves over the domain, in the image's coordinates.
        samples: number of pixels to draw.
        rng: draws them.

    Raises:
        ValueError: a drawn pixel is not finite.
    """
    y, x = np.nonzero(domain)
    if len(x) > samples:
        side = tree.sizes[tree.locate(np.stack([x, y], axis=1))]
        # the smallest of exponentials with rates 1 / h² are a weighted draw without replacement
        chosen = np.argpartition(rng.standard_exponential(len(x)) * side**2, samples)[:samples]
        y, x = y[chosen], x[chosen]
    colors = image[y, x].astype(np.float64)
    if not np.isfinite(colors).all():
        raise ValueError("the image has non-finite values inside the domain")
    return Sample(np.stack([x, y], axis=1).astype(np.float64), colors)


def highlight_trust(sample: Sample, side: float) -> Doubles:
    """Trust in each pixel, near 0 on specular highlights: much brighter than around them, and paler or clipped.

    A highlight adds the colour of the light to that of the skin, so it loses saturation; skin that is merely better
    lit keeps it. Leaves at the curves are finer than a highlight, so the fit's own residual cannot show it: brightness
    is compared with the median of square cells instead.

    Args:
        sample: n pixels.
        side: of the cells, in pixels.

    Returns:
        (n,) float64 in [0.001, 1].
    """
    top, low = sample.colors.max(axis=1), sample.colors.min(axis=1)
    luma = sample.colors @ LUMA
    saturation = (top - low) / np.maximum(top, 1.0)
    cells = np.floor(sample.points / side).astype(np.int64)
    _, cell = np.unique(cells @ (1 << 20, 1), return_inverse=True)
    order = np.lexsort((luma, cell))
    counts = np.bincount(cell)
    starts = np.cumsum(counts) - counts

    def quantile(values: Doubles, ranking: NDArray[Any], share: float) -> Doubles:
        picked: Doubles = values[ranking[starts + (share * (counts - 1)).astype(np.int64)]]
        return picked

    middle = quantile(luma, order, 0.5)
    spread = (quantile(luma, order, 0.75) - quantile(luma, order, 0.25)) / _QUARTILES_A_SPREAD
    typical = quantile(saturation, np.lexsort((saturation, cell)), 0.5)
    excess = (luma - middle[cell]) / np.maximum(spread, _LEAST_SPREAD)[cell]
    pale = (saturation < _PALER * typical[cell]) | (low >= _CLIPPED)
    suspicion = np.where(pale, ramp(excess, *_BRIGHTER), 0.0)
    return np.maximum(1.0 - suspicion, _LEAST_TRUST)
