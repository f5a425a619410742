"""Receivers of webhooks: real servers that take, fail, hang or redirect as they are told."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from standardwebhooks import Webhook

from tests.service.servers import free_port
from tests.waiting import until


@dataclass(frozen=True)
class Arrived:
    """A request as it came."""

    headers: dict[str, str]
    body: bytes
    path: str
    at: float

    @property
    def id(self) -> str:
        return self.headers["webhook-id"]

    def verified(self, secret: str) -> dict[str, Any]:
        """What it says, if its signature is good. Raises `standardwebhooks.WebhookVerificationError`."""
        said: dict[str, Any] = Webhook(secret).verify(self.body, self.headers)
        return said


@dataclass
class Receiver:
    """Answers its requests one after the other with ``answers``: statuses, the last one for all that follow.

    It is silent for ``hang_s`` before the first ``hangs`` answers. ``location`` is where its redirects lead.
    """

    port: int = field(default_factory=free_port)
    answers: Sequence[int] = (204,)
    hangs: int = 0
    hang_s: float = 120.0
    location: str = ""
    got: list[Arrived] = field(default_factory=list)
    #: how many requests were being answered at a time, at most
    most: int = 0
    _now: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _over: threading.Event = field(default_factory=threading.Event)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/hook?token=not-for-logs"

    @contextmanager
    def listening(self) -> Iterator[Receiver]:
        server = ThreadingHTTPServer(("127.0.0.1", self.port), _handler(self))
        threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
        try:
            yield self
        finally:
            self._over.set()
            server.shutdown()
            server.server_close()

    def wait_for(self, number: int, seconds: float = 60) -> None:
        until(lambda: len(self.got) >= number, seconds)

    def _take(self, arrived: Arrived) -> int:
        with self._lock:
            self._now += 1
            self.most = max(self.most, self._now)
            self.got.append(arrived)  # last: who waits for it reads the figures above next
            number = len(self.got)
        if number <= self.hangs:
            self._over.wait(self.hang_s)
        with self._lock:
            self._now -= 1
        return self.answers[min(number, len(self.answers)) - 1]


def _handler(receiver: Receiver) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["content-length"]))
            headers = {name.lower(): value for name, value in self.headers.items()}
            status = receiver._take(Arrived(headers, body, self.path, time.monotonic()))
            try:
                self.send_response(status)
                if receiver.location:
                    self.send_header("Location", receiver.location)
                self.send_header("Content-Length", "0")
                self.end_headers()
            except OSError:
                pass  # nobody waited for so long

        def log_message(self, *_: object) -> None:
            pass

    return Handler
