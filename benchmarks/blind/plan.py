"""Which clip meets which portrait, in which frames, and which side ours is on; all of it follows from the seed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

STRIP_FRAMES = 4
_STRIP_ENDS = (0.08, 0.92)  # of the frames with a face


@dataclass(frozen=True)
class Pair:
    """A sheet to be made: whether it shows one frame or a strip, and whether ours is side A.

    place: in [0, 1], where in the clip a still is taken.
    """

    number: int
    clip: Path
    reference: Path
    strip: bool
    ours_is_a: bool
    place: float

    def frames(self, seen: Sequence[int]) -> list[int]:
        """The frames shown, of those in which the face is seen; a picture has one, also on a strip."""
        shares = np.linspace(*_STRIP_ENDS, STRIP_FRAMES) if self.strip else np.array([self.place])
        return list(dict.fromkeys(seen[int(i)] for i in np.rint(shares * (len(seen) - 1))))


def plan_pairs(clips: Sequence[Path], portraits: Sequence[Path], count: int, seed: int) -> list[Pair]:
    """`count` pairs over all clips and portraits alike, every second one a strip, as many sides A as B."""
    rng = np.random.default_rng(seed)
    mixed_clips = [clips[int(i)] for i in rng.permutation(len(clips))]
    mixed = [portraits[int(i)] for i in rng.permutation(len(portraits))]
    met = []
    for k in range(count):
        turn, i = divmod(k, len(clips))
        met.append((mixed_clips[i], mixed[(i + turn) % len(mixed)]))
    order = rng.permutation(count)
    sides = rng.permutation(np.arange(count) % 2 == 0)
    places = rng.uniform(0.05, 0.95, count)
    return [
        Pair(n + 1, *met[int(k)], strip=n % 2 == 1, ours_is_a=bool(sides[n]), place=float(places[n]))
        for n, k in enumerate(order)
    ]
