"""A face in its own coordinates, some hundreds of cells: what its light is told by from row to row."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pvg._arrays import Bools, Floats
from pvg.face import Landmarks
from pvg.picture import Picture, rms_contrast
from pvg.raster import centers_in_unit, scaled
from pvg.skin import Matte

_SIDE, _OVERSAMPLED = 24, 3  # cells of a face in its own coordinates, and pixels read a side of each
_PLACES = np.array([(0.3, 0.32), (0.7, 0.32), (0.5, 0.75)], np.float32)  # where eyes and mouth lie
_DARK = 4.0  # levels added to both sides of a ratio
_LEAST_LUMA = 14.0  # levels of the median that colours can be fitted at
_LEAST_SEEN = 0.6  # of the key's open cells, and …
_NEARLY_ALL = 0.8  # … for a tint: masks leave out what has turned another colour, or what has not
_ALIKE = 0.8  # of the cells seen that changed by half of the median's change or more
_GREY = 0.12  # of the logarithms of R / G and B / G: skin in any light has more [measured: 0.17 at least in 15 clips]
_LIKENESS = 0.75  # correlation of the pattern with the key's: less and something else is seen

SAME_LIGHT = 0.047
"""Of log luma: a gain up to which a face is still in the key's own light."""
SAME_COLOUR = 0.06
"""Of the logarithms of R / G and B / G: likewise, of the light's colour."""


def _ellipse() -> Bools:
    """(SIDE, SIDE) bool, the cells of a patch within the face."""
    places = centers_in_unit(_SIDE)
    return np.asarray(((places - 0.5) / 0.42) ** 2 + ((places[:, None] - 0.5) / 0.48) ** 2 < 1)


_FACE = _ellipse()


@dataclass(frozen=True, eq=False)
class FacePatch:
    """A face in its own coordinates.

    luma: (SIDE, SIDE) float32, 0-255;  hues: (SIDE, SIDE, 2) float32, the logarithms of R / G and B / G;
    skin: (SIDE, SIDE) bool, open skin within the face; SIDE is 24.
    """

    luma: Floats
    hues: Floats
    skin: Bools

    @classmethod
    def of(cls, picture: Picture, landmarks: Landmarks, matte: Matte) -> FacePatch:
        """The patch of a face in a picture, eyes and mouth where they always are."""
        marks = landmarks.eyes_and_mouth
        places, fine = np.asarray(_PLACES * (_SIDE - 1), np.float32), _SIDE * _OVERSAMPLED
        to_source = cv2.getAffineTransform(scaled(places, float(_OVERSAMPLED)), marks)
        read = picture.warp(np.asarray(to_source, np.float64), (fine, fine))
        rgb = cv2.resize(read, (_SIDE, _SIDE), interpolation=cv2.INTER_AREA)
        to_cells = cv2.getAffineTransform(places, matte.raster.to_cells(marks))
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        alpha = cv2.warpAffine(matte.alpha, to_cells, (_SIDE, _SIDE), flags=flags)
        luma = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float32)
        levels = np.log(rgb.astype(np.float32) + np.float32(_DARK))
        return cls(luma, levels[..., [0, 2]] - levels[..., 1:2], (alpha > 0.9 * 255) & _FACE)

    @property
    def face_luma(self) -> Floats:
        """(n,) luma of the cells within the face."""
        return self.luma[_FACE]

    @property
    def contrast(self) -> float:
        """That of the face, see `pvg.picture.rms_contrast`."""
        return rms_contrast(self.face_luma)

    def gain_over(self, key: FacePatch) -> float:
        """The logarithm of how much brighter the open skin is than on the key's patch; NaN when it cannot be told."""
        if (both := self._seen_too(key, _LEAST_SEEN)) is None:
            return float("nan")
        change = np.log((self.luma[both] + _DARK) / (key.luma[both] + _DARK))
        gain = float(np.median(change))
        if abs(gain) > SAME_LIGHT:
            alike = np.mean(change * np.sign(gain) >= abs(gain) / 2)
            with np.errstate(invalid="ignore", divide="ignore"):  # a flat face has no pattern: NaN
                likeness = np.corrcoef(self.face_luma, key.face_luma)[0, 1]
            if alike < _ALIKE or not likeness >= _LIKENESS:
                return float("nan")
        return gain

    def tint_over(self, key: FacePatch) -> Floats:
        """(2,) the logarithms of how much more R and B the open skin has beside G than on the key's patch.

        NaN when it cannot be told, as of `gain_over`, or when it is another one here than there: blood, shade, a hand;
        and where either is grey: what loses its colours is in no other light.
        """
        unknown = np.full(2, np.nan, np.float32)
        if (both := self._seen_too(key, _NEARLY_ALL)) is None:
            return unknown
        if min(float(np.abs(np.median(one.hues[both], axis=0)).max()) for one in (self, key)) < _GREY:
            return unknown
        change = self.hues[both] - key.hues[both]
        tint = np.median(change, axis=0).astype(np.float32)
        size = float(np.abs(tint).max())
        alike = np.mean(np.abs(change - tint).max(axis=1) <= size / 2)
        return unknown if size > SAME_COLOUR and alike < _ALIKE else tint

    def _seen_too(self, key: FacePatch, least: float) -> Bools | None:
        """(SIDE, SIDE) cells of the key's open skin that are seen here; None if dark or less than `least` of them."""
        both = self.skin & key.skin
        few = both.sum() < max(1.0, least * key.skin.sum())
        return None if few or np.median(self.luma[both]) < _LEAST_LUMA else both
