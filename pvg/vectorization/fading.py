"""How a face's correction comes and goes with the face."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from scipy.ndimage import distance_transform_edt

from pvg._arrays import Bools, Floats
from pvg.landmarks import FaceTrack

FADE_REACH = 5  # a lost face's correction fades over the frames nearer than this


def opacity(track: FaceTrack, shots: Collection[int], frame_count: int, *, left_picture: bool = False) -> Floats:
    """(n,) 1 where the face is seen, falling to 0 over some frames towards those where it is not.

    shots: first frames of the shots. At a cut the face comes and goes whole, as the picture does, and it leaves the
    picture whole (left_picture); a face that appears or is lost within a shot comes and goes softly.
    """
    before = track.first in shots or track.first == 0
    after = left_picture or track.last + 1 in shots or track.last + 1 >= frame_count
    return faded(track.score > 0, before=before, after=after)


def faded(seen: Bools, *, before: bool, after: bool) -> Floats:
    """`opacity` of frames (n,) that show the face or not, and whether it counts as seen before and after them.

    What lies FADE_REACH frames away or more has no influence.
    """
    padded = np.pad(seen, 1)
    padded[0], padded[-1] = before, after
    padded = np.pad(padded, FADE_REACH, mode="edge")
    if padded.all():
        return np.ones(len(seen), np.float32)
    out: Floats = np.clip(distance_transform_edt(padded) / FADE_REACH, 0, 1).astype(np.float32)
    return out[FADE_REACH + 1 : -FADE_REACH - 1]
