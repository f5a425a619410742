"""A look: new boundary colours for a clip, and how they are to be drawn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pvg._arrays import Floats

CONTRAST_RANGE = (0.7, 1.5)  # of λ [paper]
PROTECTABLE = ("eyes", "teeth")

Contrast = float | Literal["auto"]


@dataclass(frozen=True, eq=False)
class Look:
    """New boundary colours for a clip.

    colors: for each face index of the look, (K, S, 3) float32 g' of its K key frames, 0-255 RGB, strength applied;
    contrast: λ of u' = λI + H(g' − λg), or "auto" for a field that follows the brightness that is asked for;
    strength: in [0, 1], already in `colors`, applied to the contrast when rendering;  protect: features that keep
    their own colour.
    """

    colors: dict[int, Floats]
    contrast: Contrast = 1.0
    strength: float = 1.0
    protect: tuple[str, ...] = PROTECTABLE
