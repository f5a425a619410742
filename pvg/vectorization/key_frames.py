"""The row of a clip's track that its colours are taken from: the first that shows the face well.

So a clip of one shot starts where the paper's does.
"""

from __future__ import annotations

import numpy as np

from pvg._arrays import Bools
from pvg.landmarks import FaceTrack

_FRONTAL_DEG = 25.0  # yaw and pitch up to which a face is turned to the camera
_GOOD_SCORE = 0.8


def good_rows(track: FaceTrack) -> Bools:
    """(n,) whether a row shows the face well: sure of itself and turned to the camera."""
    turned = np.abs(track.pose[:, :2]).max(axis=1)
    return np.asarray((track.score >= _GOOD_SCORE) & (turned <= _FRONTAL_DEG))


def first_good_row(track: FaceTrack, clear: Bools | None = None) -> int:
    """The first row that shows the face well, else the best one.

    clear: (n,) which rows are to be taken if one of them shows it well.
    """
    good = good_rows(track)
    if clear is not None and (good & clear).any():
        good &= clear
    turned = np.abs(track.pose[:, :2]).max(axis=1)
    return int(np.argmax(good)) if good.any() else int(np.argmax(track.score - turned / 90.0))
