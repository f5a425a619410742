"""Maps from a clip's boundary colours to new ones; here the paper's, which moves all of them together (eq. 7, 8)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pvg._arrays import Doubles, Floats
from pvg.asset import KeyFrame
from pvg.looks.tone import to_opponent
from pvg.looks.transport import sliced_transport

SMALLEST_GROUP = 8  # fewer visible samples say nothing about a group's colours [by eye]

ColorMap = Callable[[KeyFrame], tuple[Doubles, Floats]]
"""The new boundary colours (S, 3) of a key frame and the λ they ask for, (S, 2) for luma and chroma."""


@dataclass(frozen=True)
class TransportSteps:
    """Parameters of eq. (7): β and N, and the seed of the random rotations."""

    beta: float
    iterations: int
    seed: int

    def transport(self, colors: Floats, reference: Floats) -> Doubles:
        """Colours (n, 3) moved to the distribution of the reference's (m, 3).

        Each transport has a generator of its own, seeded alike: another look or face cannot shift its rotations.
        """
        rng = np.random.default_rng(self.seed)
        return sliced_transport(colors, reference, beta=self.beta, iterations=self.iterations, rng=rng)


def all_colors_map(key: KeyFrame, target: KeyFrame, steps: TransportSteps) -> ColorMap:
    """The paper's way: all boundary colours of `key` transported together.

    What is hidden on either side takes no part, so that a clip's own colours stay as they are. The clip's hidden
    samples, and those of other key frames, then move as the transported ones of like colour do.
    """
    seen, wanted = key.colors[key.visible], target.colors[target.visible]
    if min(len(seen), len(wanted)) < SMALLEST_GROUP:
        return lambda other: (other.colors.astype(np.float64), np.ones((len(other.colors), 2), np.float32))
    moved = steps.transport(seen, wanted)

    def apply(other: KeyFrame) -> tuple[Doubles, Floats]:
        new = colors(other)
        return new, ratio_contrast(other.colors, new)

    def colors(other: KeyFrame) -> Doubles:
        if other.frame != key.frame:  # its own, whatever light it is seen in
            return _follow_like_colors(other.colors, seen, moved)
        out = key.colors.astype(np.float64)
        out[key.visible] = moved
        if not key.visible.all():
            out[~key.visible] = _follow_like_colors(key.colors[~key.visible], seen, moved)
        return out

    return apply


def _follow_like_colors(colors: Floats, seen: Floats, moved: Doubles) -> Doubles:
    """Colours (n, 3), each shifted by the mean shift of those of `seen` (m, 3), moved to `moved`, nearest to it."""
    from scipy.spatial import KDTree  # noqa: PLC0415 - half a second of start-up that few looks need

    count = min(SMALLEST_GROUP, len(seen))
    distance, nearest = KDTree(seen).query(colors, k=count)
    weight = 1.0 / (np.asarray(distance) + 1.0)
    weight /= weight.sum(axis=1, keepdims=True)
    return np.asarray(colors + np.einsum("nk,nkc->nc", weight, (moved - seen)[nearest]))


_RATIO_EXPONENT = 0.6  # of the luma ratio [by eye: 0.5 to 0.75 keeps eyes and brows crisp, 1 looks harsh]
_RATIO_RANGE = (0.5, 1.6)  # [by eye: more turns lips and lids white where a dark face is made pale]
_CHROMA_RANGE = (0.25, 1.5)  # [by eye: more would lift the noise that coding leaves in chroma]
_LEAST_CHROMA = 4.0  # levels added to both sides of the ratio, so that grey skin does not explode [by eye]


def ratio_contrast(g: Floats, new: Doubles) -> Floats:
    """λ (n, 2) of luma and chroma that follows how much brighter and more colourful each colour becomes."""
    before, after = to_opponent(g), to_opponent(new)
    luma = (np.maximum(after[:, 0], 0.0) + 1.0) / (np.maximum(before[:, 0], 0.0) + 1.0)
    chroma = [np.hypot(*one[:, 1:].T) + _LEAST_CHROMA for one in (after, before)]
    fields = [np.clip(luma**_RATIO_EXPONENT, *_RATIO_RANGE), np.clip(chroma[0] / chroma[1], *_CHROMA_RANGE)]
    return np.stack(fields, axis=1).astype(np.float32)
