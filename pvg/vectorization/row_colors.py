"""The colours that one row of a track shows beside those on its curves: of its open skin, and of its parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pvg._arrays import Floats
from pvg.face import Landmarks
from pvg.picture import Picture, cut_out
from pvg.skin import Matte
from pvg.vectorization.open_skin import skin_sample
from pvg.vectorization.part_colors import part_colors, shows_lips, without_covered_lips

_SAMPLE_MARGIN = 0.06  # of the face's width: reach of what smooths the sampled skin


@dataclass(frozen=True, eq=False)
class RowColors:
    """Colours that one row of a track shows, 0-255 RGB float32.

    skin: (n, 3) of open skin, none where too little of it is seen;  places: (n, 2) where it is, source pixels;
    parts: (P, 3) of `pvg.face.PARTS`, NaN where a part is not seen.
    """

    skin: Floats
    places: Floats
    parts: Floats

    @classmethod
    def of(cls, picture: Picture, landmarks: Landmarks, matte: Matte) -> RowColors:
        """Those of a face in a picture, with its matte there."""
        skin, places = _open_skin(picture, landmarks, matte)
        return cls(skin, places, without_covered_lips(part_colors(picture, landmarks, matte), skin))

    @property
    def show_lips(self) -> bool:
        """Whether lips are seen, and skin beside them."""
        return bool(len(self.skin)) and shows_lips(self.parts)


def _open_skin(picture: Picture, landmarks: Landmarks, matte: Matte) -> tuple[Floats, Floats]:
    """The open skin and where it is in the picture, see `skin_sample`; looked for within the face contour only."""
    margin, skin = _SAMPLE_MARGIN * landmarks.axes.width + 2, landmarks.skin_points
    rgb, corner = cut_out(picture, np.concatenate([skin.min(axis=0) - margin, skin.max(axis=0) + margin]))
    alpha = matte.crop(corner).alpha_at(*(np.arange(n, dtype=np.float32) for n in (rgb.shape[1], rgb.shape[0])))
    colors, places = skin_sample(rgb, alpha, landmarks.moved(-corner))
    return colors, places + corner
