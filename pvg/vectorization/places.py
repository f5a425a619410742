"""Where the faces of the first reading are, for the second one: others' bodies end where theirs begins."""

from __future__ import annotations

from collections.abc import Callable

from pvg.face import Landmarks
from pvg.landmarks import FaceTrack

_EVERY = 4  # frames from one place of a face that is kept to the next


class Places:
    """Where faces are in every fourth frame, by the number of their track."""

    def __init__(self) -> None:
        self._spans: dict[int, tuple[int, int]] = {}  # the first and last frame of each
        self._at: dict[int, dict[int, Landmarks]] = {}  # by frame, and by number

    def add(self, number: int, rows: FaceTrack) -> None:
        """Note the next rows of a track."""
        first, _ = self._spans.get(number, (rows.first, 0))
        self._spans[number] = first, rows.last
        for k in range(-rows.first % _EVERY, len(rows.score), _EVERY):
            self._at.setdefault(rows.first + k, {})[number] = rows.landmarks[k].copy()

    def near(self, frame: int) -> list[Landmarks]:
        """About where the faces are that are there in a frame, source pixels."""
        before = frame - frame % _EVERY
        places = self._at.get(before + _EVERY, {}) | self._at.get(before, {})
        spans = ((self._spans[number], place) for number, place in places.items())
        return [place for (first, last), place in spans if first <= frame <= last]

    def forget(self, start: int, stop: int, *, but: Callable[[int, int], bool]) -> None:
        """Let go of the places that no frame from `stop` on is told by, where [0, start) was done before.

        but: whether some of the frames of a range, its first and last, will be asked for.
        """
        for frame in range(start - start % _EVERY, stop - _EVERY + 1, _EVERY):
            if not but(frame - _EVERY + 1, frame + _EVERY - 1):
                self._at.pop(frame, None)
