"""Fades from and to white: how far a face shows through what lies over the whole picture.

Light that changes scales a picture, a fade to white takes its contrast away as well: of a picture I, v of the way to
white, there is (1 − v) I + v W. What a look changes must fade alike, or its face is left on a white picture. Told by
the contrast c (`pvg.picture.rms_contrast`) of the face and of the whole picture, beside that of the track's key frame:
a face that is lit more softly leaves the picture's contrast, and a picture that shows another place leaves the face's.
"""

from __future__ import annotations

from dataclasses import dataclass

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
