"""The pool of a worker on the embedded broker: a child that is killed while it waits takes no lock with it.

Celery's children there share one pipe of messages and a lock, which the one that waits for the next message holds. When
it is killed, nobody gives the lock back, and no child ever gets a message again. Here each message is one packet of a
socket: the kernel hands it whole to one of those that wait, and there is no lock. On other brokers each child has its
own pipe, and this is not used.
"""

from __future__ import annotations

import select
import socket
import sys
from typing import Any, Final

from billiard.pool import Pool as _LockingPool
from billiard.reduction import ForkingPickler
from celery.concurrency.prefork import TaskPool as _TaskPool

#: of one message: the name of the task and a job's id, with Celery's headers around them
_MOST_BYTES: Final = 2**17


class _End:
    """One end of the socket, as billiard uses a connection."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end

    def fileno(self) -> int:
        return self._end.fileno()

    def send(self, message: object) -> None:
        self._end.send(ForkingPickler.dumps(message))

    def recv_bytes(self) -> bytes:
        """The next packet. Raises `EOFError` when there will be none, as the other end is closed everywhere."""
        data = self._end.recv(_MOST_BYTES)
        if not data:
            raise EOFError
        return data

    def recv(self) -> Any:
        return ForkingPickler.loads(self.recv_bytes())

    def poll(self, timeout_s: float = 0.0) -> bool:
        return bool(select.select([self._end], [], [], timeout_s)[0])

    def drop(self) -> bool:
        """Take a packet if there is one, and forget it; a child may be faster."""
        try:
            return bool(self._end.recv(_MOST_BYTES, socket.MSG_DONTWAIT))
        except BlockingIOError:
            return False

    def close(self) -> None:
        self._end.close()


class _Packets:
    """A queue of messages to whichever child is free, as billiard uses one."""

    def __init__(self) -> None:
        reading, writing = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._reader, self._writer = _End(reading), _End(writing)
        self.put, self.get, self.get_payload = self._writer.send, self._reader.recv, self._reader.recv_bytes

    def close(self) -> None:
        self._reader.close()
        self._writer.close()


class Pool(_LockingPool):  # type: ignore[misc]
    """billiard's pool, whose children wait for messages without a lock."""

    _inqueue: Any

    def _setup_queues(self) -> None:
        super()._setup_queues()
        if sys.platform == "linux":
            self._inqueue.close()
            self._inqueue = _Packets()
            self._quick_put = self._inqueue.put

    @staticmethod
    def _help_stuff_finish(inqueue: Any, task_handler: Any, pool: Any) -> None:
        """Take what no child will take, so that the thread that sends is not stuck."""
        if not isinstance(inqueue, _Packets):
            _LockingPool._help_stuff_finish(inqueue, task_handler, pool)
            return
        while task_handler.is_alive() and inqueue._reader.drop():
            pass


class TaskPool(_TaskPool):  # type: ignore[misc]
    """Celery's pool of processes with the pool above where it has no event loop."""

    BlockingPool = Pool
