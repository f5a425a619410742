"""Maps from a clip's boundary colours to new ones; here the paper's, which moves all of them together (eq. 7, 8)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Doubles, Floats
from pvg.asset import KeyFrame
from pvg.looks.transport import sliced_transport

SMALLEST_GROUP = 8  # fewer visible samples say nothing about a group's colours [by eye]

_KEPT = 16  # transports of some kB each: two a person

ColorMap = Callable[[KeyFrame], Doubles]
"""The new boundary colours (S, 3) of a key frame."""


@dataclass(frozen=True)
class TransportSteps:
    """Parameters of eq. (7): β and N, and the seed of the random rotations."""

    beta: float
    iterations: int
    seed: int

    def transport(self, colors: Floats, reference: Floats) -> Doubles:
        """Colours (n, 3) moved to the distribution of the reference's (m, 3); read-only.

        Each transport has a generator of its own, seeded alike: another look or face cannot shift its rotations.
        The last ones are kept, since looks that differ in strength, contrast or make-up share theirs.
        """
        return _moved(self, _Colors.of(colors), _Colors.of(reference))


@dataclass(frozen=True)
class _Colors:
    """Colours as a value that compares by its bytes."""

    data: bytes
    dtype: str

    @classmethod
    def of(cls, colors: Floats) -> _Colors:
        return cls(np.ascontiguousarray(colors).tobytes(), colors.dtype.str)

    def array(self) -> NDArray[Any]:
        return np.frombuffer(self.data, self.dtype).reshape(-1, 3)


@lru_cache(maxsize=_KEPT)
def _moved(steps: TransportSteps, colors: _Colors, reference: _Colors) -> Doubles:
    rng = np.random.default_rng(steps.seed)
    moved = sliced_transport(colors.array(), reference.array(), beta=steps.beta, iterations=steps.iterations, rng=rng)
    moved.flags.writeable = False
    return moved


def all_colors_map(key: KeyFrame, target: KeyFrame, steps: TransportSteps) -> ColorMap:
    """The paper's way: all boundary colours of `key` transported together.

    What is hidden on either side takes no part, so that a clip's own colours stay as they are. The clip's hidden
    samples, and those of other key frames, then move as the transported ones of like colour do.
    """
    seen, wanted = key.colors[key.visible], target.colors[target.visible]
    if min(len(seen), len(wanted)) < SMALLEST_GROUP:
        return lambda other: other.colors.astype(np.float64)
    moved = steps.transport(seen, wanted)

    def apply(other: KeyFrame) -> Doubles:
        if not np.array_equal(other.colors, key.colors):  # its own may stand for a frame with too little skin, too
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
