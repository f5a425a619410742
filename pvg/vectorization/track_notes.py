"""What is noted of a track while its rows go by, since the rows themselves are not kept: how wide, and who."""

from __future__ import annotations

from array import array

import numpy as np

from pvg._arrays import Floats
from pvg.landmarks import RATIOS, FaceShape, FaceTrack, frontal_ratios, proportions_of


class TrackNotes:
    """Notes of one track: some 48 bytes a frame until its end, when they become medians, which need all of them.

    first, last: its first frame, and the last one that was noted.
    """

    def __init__(self, first: int) -> None:
        self.first = self.last = first
        self._extents, self._ratios = array("f"), array("f")  # which grow by a sixteenth, and have no objects in them
        self._ended: tuple[float, FaceShape] | None = None

    def add(self, rows: FaceTrack) -> None:
        """Note the next rows."""
        self.last = rows.last
        self._extents.frombytes(rows.extents[rows.score > 0].tobytes())
        self._ratios.frombytes(frontal_ratios(rows).tobytes())

    def end(self) -> None:
        """Keep only what is told of the track, all of whose rows were added."""
        ratios: Floats = np.frombuffer(self._ratios, np.float32).reshape(-1, RATIOS)
        width = float(np.median(np.frombuffer(self._extents, np.float32)))
        self._ended = width, FaceShape(self.first, self.last, proportions_of(ratios))
        del ratios
        self._extents, self._ratios = array("f"), array("f")

    @property
    def width_px(self) -> float:
        """See `FaceTrack.width_px`; of a track that has ended."""
        return self._told[0]

    @property
    def shape(self) -> FaceShape:
        """What tells the person; of a track that has ended."""
        return self._told[1]

    @property
    def _told(self) -> tuple[float, FaceShape]:
        if self._ended is None:
            raise RuntimeError("the track has not ended")
        return self._ended
