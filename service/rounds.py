"""Work that is done again and again beside everything else, in a thread of its own."""

from __future__ import annotations

import threading
from collections.abc import Callable

#: seconds that whoever stops the rounds waits for the present one
_LAST_S = 2.0


class Rounds:
    """Calls ``work``, the first time at once, and again ``pause_s`` after each end. It must raise nothing."""

    def __init__(self, name: str, work: Callable[[], object], pause_s: float) -> None:
        self._work = work
        self._pause_s = pause_s
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Start the rounds."""
        self._thread.start()

    def stop(self) -> None:
        """Begin no further round, and wait a moment for the present one."""
        self._stop.set()
        self._thread.join(timeout=_LAST_S)

    @property
    def is_stopping(self) -> bool:
        """`stop` was called: a long round may end early."""
        return self._stop.is_set()

    def _run(self) -> None:
        while True:
            self._work()
            if self._stop.wait(self._pause_s):
                return
