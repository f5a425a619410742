"""Fades from and to white: how far a face shows through what lies over the whole picture.

Light that changes scales a picture, a fade to white takes its contrast away as well: of a picture I, v of the way to
white, there is (1 − v) I + v W. What a look changes must fade alike, or its face is left on a white picture. Told by
the contrast c (`pvg.picture.rms_contrast`) of the face and of the whole picture, beside that of the track's key frame:
a face that is lit more softly leaves the picture's contrast, and a picture that shows another place leaves the face's.
"""

from __future__ import annotations

from dataclasses import dataclass

from pvg.vectorization.face_patch import FacePatch

_WHITE = 255.0
_CLEAR = 0.9  # of the face: from what shows through so far on, nothing lies over it [measured: clips without fades]
_DARK = 1.0  # level of the face's mean, at least


@dataclass(frozen=True)
class Veil:
    """What a face and the picture around it are like on the key frame, where nothing lies over them.

    face_contrast, picture_contrast: see `pvg.picture.rms_contrast`;  face_luma: the face's mean, levels of 255.
    """

    face_contrast: float
    picture_contrast: float
    face_luma: float

    def transmission(self, face_contrast: float, picture_contrast: float) -> float:
        """How far a face shows through, in [0, 1], by the contrasts of it and of its picture now."""
        left = max(face_contrast / max(self.face_contrast, 1e-6), picture_contrast / max(self.picture_contrast, 1e-6))
        if left >= 1.0:
            return 1.0
        # c = (1 − v) m / ((1 − v) m + v W), solved for 1 − v
        through = left * _WHITE / (left * _WHITE + max(self.face_luma, _DARK) * (1.0 - left))
        return min(1.0, through / _CLEAR)


class VeilWatch:
    """Tells how far a face shows through, rows in order."""

    def __init__(self, key: FacePatch, picture_contrast: float | None) -> None:
        """key: the face on the track's key frame;  picture_contrast: of that whole picture, None where not known."""
        self._veil: Veil | None = None
        if picture_contrast is not None:
            self._veil = Veil(key.contrast, picture_contrast, float(key.face_luma.mean()))
        self._face_contrast = 1.0  # when it was last seen well

    def see(self, patch: FacePatch | None, picture_contrast: float | None) -> float:
        """How far the face shows through in the next row, in [0, 1]; 1 where contrasts are not known.

        patch: the face, None where it is not seen well;  picture_contrast: of the whole picture, as of the key frame's.
        """
        if self._veil is None or picture_contrast is None:
            return 1.0
        if patch is not None:
            self._face_contrast = patch.contrast
        return self._veil.transmission(self._face_contrast, picture_contrast)
