"""When something began, by the steady clock, known to every process forked from the one that looks for it."""

from __future__ import annotations

import mmap
import struct
from typing import Final

_TIME: Final = struct.Struct("d")


class SharedMoment:
    """A moment, or none, in a page of memory: processes that are forked once it is made share it."""

    def __init__(self) -> None:
        self._page = mmap.mmap(-1, _TIME.size)

    @property
    def at(self) -> float | None:
        """By `time.monotonic`; None while there is none."""
        seconds: float = _TIME.unpack_from(self._page, 0)[0]
        return seconds or None

    def begin(self, now: float) -> None:
        """It is ``now``, unless it was before."""
        if self.at is None:
            _TIME.pack_into(self._page, 0, now)

    def clear(self) -> None:
        """There is none any more."""
        _TIME.pack_into(self._page, 0, 0.0)
