"""Which clip meets which references, and which sheets are controls; all of it follows from the seed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Sheet:
    """A sheet to be made: a look, or a control.

    A control passes the untouched frame off as the result: the clip's frame with the reference's look stands for the
    clip, and another frame of the clip for the reference. Whoever finds a fault in it finds one in a real picture.
    """

    number: int
    clip: Path
    reference: Path
    control: bool


def plan_sheets(farthest: Mapping[Path, Sequence[Path]], looks: int, controls: int, seed: int) -> list[Sheet]:
    """`looks` and `controls` a clip, of its `farthest` references, in mixed order.

    Raises `ValueError` when a clip has fewer references than sheets of a kind.
    """
    rng = np.random.default_rng(seed)
    met: list[tuple[Path, Path, bool]] = []
    for clip, references in farthest.items():
        if len(references) < max(looks, controls):
            raise ValueError(f"{clip.name}: {len(references)} references for {max(looks, controls)} sheets")
        for count, control in ((looks, False), (controls, True)):
            met += [(clip, references[int(i)], control) for i in rng.permutation(len(references))[:count]]
    return [Sheet(n, *met[int(k)]) for n, k in enumerate(rng.permutation(len(met)), start=1)]
