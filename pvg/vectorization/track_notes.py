"""What is noted of a track while its rows go by, since the rows themselves are not kept: how wide, who, and where."""

from __future__ import annotations

import numpy as np

from pvg._arrays import Floats
from pvg.face import Landmarks
from pvg.landmarks import FaceShape, FaceTrack, frontal_ratios

_PLACE_EVERY = 4  # frames from one place of a face that is kept to the next: others' bodies end where theirs begins


class TrackNotes:
    """Notes of one track.

    first, last: its first frame, and the last one that was noted.
    """

    def __init__(self, first: int) -> None:
        self.first = self.last = first
        self._extents: list[Floats] = []
        self._ratios: list[Floats] = []
        self._places: dict[int, Landmarks] = {}  # by the frame, some of them

    def add(self, rows: FaceTrack) -> None:
        """Note the next rows."""
        self.last = rows.last
        self._extents.append(rows.extents[rows.score > 0])
        self._ratios.append(frontal_ratios(rows))
        for k in range(-rows.first % _PLACE_EVERY, len(rows.score), _PLACE_EVERY):
            self._places[rows.first + k] = rows.landmarks[k].copy()

    @property
    def width_px(self) -> float:
        """See `FaceTrack.width_px`."""
        return float(np.median(np.concatenate(self._extents)))

    @property
    def shape(self) -> FaceShape:
        """What tells the person."""
        return FaceShape(self.first, self.last, np.concatenate(self._ratios))

    def place(self, frame: int) -> Landmarks | None:
        """About where the face is in a frame, source pixels; None where it is not."""
        if not self.first <= frame <= self.last:
            return None
        before = frame - frame % _PLACE_EVERY
        return self._places.get(before, self._places.get(before + _PLACE_EVERY))
