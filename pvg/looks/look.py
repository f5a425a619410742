"""A look: new boundary colours for a clip, and how they are to be drawn."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from pvg._arrays import Doubles, Floats
from pvg.looks.tone import SkinMap, to_rgb

CONTRAST_RANGE = (0.7, 1.5)  # of λ [paper]
PROTECTABLE = ("eyes", "teeth")

EXTENTS = ("skin", "face")  # all skin of a person, or the face with ears and neck

Contrast = float | Literal["auto"]


@dataclass(frozen=True, eq=False)
class BodyMap:
    """What the rest of a person's skin is given: `strength` of the way from its colours to those of the map F."""

    skin: SkinMap
    strength: float

    def usual_colors(self) -> tuple[Doubles, Doubles]:
        """The colours (256, 3) that are usual at the lumas 0 to 255, 0-255 RGB, and what F makes of them."""
        skin, levels = self.skin, np.arange(256.0)
        usual = to_rgb(np.column_stack([levels, skin.own.at(levels)]))
        return usual, to_rgb(np.column_stack([skin.tone, skin.goal.at(skin.tone)]))


@dataclass(frozen=True, eq=False)
class Look:
    """New boundary colours for a clip.

    colors: for each face index of the look, (K, S, 3) float32 g' of its K key frames, 0-255 RGB, strength applied;
    contrast: λ of u' = λI + H(g' − λg), strength applied: a number, or for each face index (K, S, 2) float32, λ of luma
    and of chroma at the curves;  protect: features that keep their own colour;
    body: for each face index whose person's other skin goes along, how it does.
    """

    colors: dict[int, Floats]
    contrast: float | dict[int, Floats] = 1.0
    protect: tuple[str, ...] = PROTECTABLE
    body: dict[int, BodyMap] = field(default_factory=dict)

    def at_curves(self, face: int, key: int) -> Floats:
        """What is carried along the curves of a key frame: (S, 3) g', or (S, 5) g' and λ."""
        colors = self.colors[face][key]
        return (
            colors if isinstance(self.contrast, float) else np.concatenate([colors, self.contrast[face][key]], axis=1)
        )
