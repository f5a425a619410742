"""Servers of others, at addresses of loopback, and names that lead to them."""

from __future__ import annotations

import socket
import ssl
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

import pytest

from service import egress

#: stands for an address of the public internet; everything else of loopback is as private as it is
PUBLIC = "127.0.0.2"
PRIVATE = "127.0.0.1"

Answer = Callable[[socket.socket], None]


def answer(body: bytes = b"", status: str = "200 OK", **headers: str) -> Answer:
    """An answer with a body, whole."""
    head = "".join(f"{name.replace('_', '-')}: {value}\r\n" for name, value in headers.items())
    sent = f"HTTP/1.1 {status}\r\nContent-Length: {len(body)}\r\n{head}\r\n".encode() + body
    return lambda connection: connection.sendall(sent)


@dataclass
class Remote:
    """A server that answers by path, and knows who came and what they sent."""

    address: str
    port: int
    answers: dict[str, Answer] = field(default_factory=dict)
    connections: int = 0
    requests: list[bytes] = field(default_factory=list)
    tls: ssl.SSLContext | None = None

    def run(self, listener: socket.socket) -> None:
        with suppress(OSError):
            while True:
                connection, _ = listener.accept()
                self.connections += 1
                threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        with suppress(OSError):
            if self.tls is not None:
                connection = self.tls.wrap_socket(connection, server_side=True)
            with connection:
                connection.settimeout(60)
                request = _read(connection)
                self.requests.append(request)
                path = request.split(b" ")[1].decode().partition("?")[0]
                self.answers.get(path, answer(b"nothing", "404 Not Found"))(connection)


def _read(connection: socket.socket) -> bytes:
    data = b""
    while b"\r\n\r\n" not in data:
        more = connection.recv(65536)
        if not more:
            return data
        data += more
    head, _, body = data.partition(b"\r\n\r\n")
    for line in head.lower().split(b"\r\n"):
        if line.startswith(b"content-length:"):
            while len(body) < int(line[15:]):
                body += connection.recv(65536)
    return head + b"\r\n\r\n" + body


@contextmanager
def remote(address: str, port: int = 0, *, tls: ssl.SSLContext | None = None) -> Iterator[Remote]:
    with socket.create_server((address, port)) as listener:
        server = Remote(address, listener.getsockname()[1], tls=tls)
        threading.Thread(target=server.run, args=(listener,), daemon=True).start()
        yield server
        listener.shutdown(socket.SHUT_RDWR)


@dataclass
class Names:
    """A resolver: each name has answers, one a question, the last of which stays."""

    known: dict[str, list[list[str]]] = field(default_factory=dict)
    asked: list[str] = field(default_factory=list)

    def tell(self, name: str, *answers: str | list[str]) -> None:
        self.known[name] = [[one] if isinstance(one, str) else one for one in answers]

    def find(self, real: Callable[..., Any], host: Any, port: Any, *args: Any, **kwargs: Any) -> Any:
        name = host.decode() if isinstance(host, bytes) else str(host)
        if kwargs.get("flags", 0) & socket.AI_NUMERICHOST or name.rstrip(".") not in self.known:
            if not kwargs.get("flags", 0) & socket.AI_NUMERICHOST and name.endswith(".example"):
                raise socket.gaierror(socket.EAI_NONAME, "no such name")
            return real(host, port, *args, **kwargs)
        self.asked.append(name)
        answers = self.known[name.rstrip(".")]
        addresses = answers.pop(0) if len(answers) > 1 else answers[0]
        families = [(socket.AF_INET6 if ":" in one else socket.AF_INET, one) for one in addresses]
        return [(family, socket.SOCK_STREAM, 6, "", (one, port)) for family, one in families]


@pytest.fixture
def names(monkeypatch: pytest.MonkeyPatch) -> Names:
    """Whatever in this process resolves a name asks here first."""
    found, real = Names(), socket.getaddrinfo
    monkeypatch.setattr(socket, "getaddrinfo", lambda *args, **kwargs: found.find(real, *args, **kwargs))
    return found


@pytest.fixture
def public_loopback(monkeypatch: pytest.MonkeyPatch) -> None:
    """`PUBLIC` counts as public. What is public in truth is in the tests of `is_public`."""
    real = egress.is_public
    monkeypatch.setattr(egress, "is_public", lambda address: str(address) == PUBLIC or real(address))


_CONNECTED: list[str] = []
_HOOKED = threading.Event()


def _note(event: str, details: tuple[Any, ...]) -> None:
    if event == "socket.connect" and _HOOKED.is_set() and isinstance(details[1], tuple):
        address = str(details[1][0])
        _CONNECTED.append(address)
        if not address.startswith("127."):
            raise OSError("no test leaves this machine")


@pytest.fixture
def connected() -> Iterator[list[str]]:
    """Every address that this process connects to, as the interpreter sees it; only loopback's are reached."""
    if not getattr(_note, "installed", False):
        sys.addaudithook(_note)  # for good
        _note.installed = True  # type: ignore[attr-defined]
    _CONNECTED.clear()
    _HOOKED.set()
    yield _CONNECTED
    _HOOKED.clear()
