"""Names of hosts looked up in threads that nobody has to wait for.

A pool of `concurrent.futures` will not do: a process waits for the threads of all pools before it ends, and a name
server that does not answer keeps a thread for minutes, longer than anybody waits for it. So an owner, who may name
such a server, has `RESOLVERS_OF_ONE` of them at a time.
"""

from __future__ import annotations

import socket
import threading
from collections import Counter, deque
from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, Final

from service.errors import StoppingError

#: what `socket.getaddrinfo` returns
Found = Sequence[tuple[Any, ...]]

#: names that are looked up at a time: a resolver that hangs holds no other thread of the service
RESOLVERS: Final = 32
#: and of them those of one owner: what names he asks for is up to him, and who answers for them
RESOLVERS_OF_ONE: Final = 2
_STOPS: Final = "the service stops"


@dataclass(frozen=True, eq=False)
class _Asked:
    """A name that an owner wants looked up."""

    owner: str
    name: str
    port: int
    found: Future[Found]


class Resolver:
    """Looks names up in threads of its own, for several event loops."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        #: what waits for its turn, the first one first
        self._waiting: deque[_Asked] = deque()
        #: lookups of each owner that have not come back, also those that nobody waits for any more
        self._of: Counter[str] = Counter()
        self._threads = 0
        self._is_closed = False

    def look_up(self, owner: str, name: str, port: int) -> Future[Found]:
        """The addresses of a name; those that an owner, or all, ask for beyond their share come when their turn comes.

        Raises `StoppingError` after `close`; what waits then for its turn ends with it.
        """
        found: Future[Found] = Future()
        with self._changed:
            if self._is_closed:
                raise StoppingError(_STOPS)
            self._waiting = deque(one for one in self._waiting if not one.found.cancelled())
            self._waiting.append(_Asked(owner, name, port, found))
            if self._threads < min(self._of.total() + len(self._waiting), RESOLVERS):
                threading.Thread(target=self._run, name=f"resolve-{self._threads}", daemon=True).start()
                self._threads += 1
            self._changed.notify()
        return found

    def close(self) -> None:
        """Look no more names up, also none of those that wait for their turn."""
        with self._changed:
            self._is_closed = True
            while self._waiting:
                found = self._waiting.popleft().found
                # not cancelled: whoever waits for it was not
                if found.set_running_or_notify_cancel():
                    found.set_exception(StoppingError(_STOPS))
            self._changed.notify_all()

    def _run(self) -> None:
        while (asked := self._next()) is not None:
            if asked.found.set_running_or_notify_cancel():  # else nobody waits for it any more
                try:
                    asked.found.set_result(socket.getaddrinfo(asked.name, asked.port, type=socket.SOCK_STREAM))
                except Exception as error:
                    asked.found.set_exception(error)
            with self._changed:  # this thread takes what the place comes free for
                self._of[asked.owner] -= 1
                self._of = +self._of

    def _next(self) -> _Asked | None:
        """The first of those whose owner has a place, which it takes; None after `close`."""
        with self._changed:
            while not self._is_closed:
                for asked in self._waiting:
                    if self._of[asked.owner] < RESOLVERS_OF_ONE:
                        self._waiting.remove(asked)
                        self._of[asked.owner] += 1
                        return asked
                self._changed.wait()
        return None
