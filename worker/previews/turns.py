"""Whose picture is made next: that of the key that has the fewest at work here, then the oldest.

A message names a picture, but is a turn for whichever is next. Of one clip only one picture is made at a time, so a
request for a clip that is at work takes no thread: its turn is owed, and taken by the next thread that is done.
"""

from __future__ import annotations

import threading
from collections import Counter

from service.catalog import Database, Preview, previews


class Turns:
    """The turns of the threads of one worker. A picture that is not begun in ``within_s`` is passed over."""

    def __init__(self, database: Database, within_s: float) -> None:
        self._database = database
        self._within_s = within_s
        self._lock = threading.Lock()
        self._at_work: dict[str, Preview] = {}
        self._owed = 0

    def begin(self) -> Preview | None:
        """After a message: the picture to be made now. None when there is none, or those that wait have to wait on."""
        with self._lock:
            self._owed += 1
            return self._next()

    def go_on(self) -> Preview | None:
        """After a picture: one whose turn was put off meanwhile."""
        with self._lock:
            return self._next() if self._owed else None

    def end(self, preview: Preview) -> None:
        """A picture that was taken is made, or cannot be."""
        with self._lock:
            self._at_work.pop(preview.id, None)

    def _next(self) -> Preview | None:
        taken = None
        with self._database.write() as session:
            now = self._database.now()
            asked = previews.waiting(session, now=now, within_s=self._within_s)
            busy = {_clip(one) for one in self._at_work.values()}
            load = Counter(one.owner for one in self._at_work.values())
            free = [one for one in asked if _clip(one) not in busy]
            for one in sorted(free, key=lambda preview: load[preview.owner]):
                # another worker may have been quicker
                taken = previews.take(session, one.id, now=now, within_s=self._within_s)
                if taken is not None:
                    break
        if taken is None:
            self._owed = min(self._owed, len(asked) - len(free))
            return None
        self._owed -= 1
        self._at_work[taken.id] = taken
        return taken


def _clip(preview: Preview) -> tuple[str, str | None]:
    """What is opened for a picture; see `worker.previews.open_clips.Clip`."""
    return preview.media_id, preview.reference_id
