"""The server that runs the API: its sockets, its descriptors, and what happens when they run out."""

from __future__ import annotations

import asyncio
import errno
import gc
import math
import resource
import socket
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any, Final

import structlog
import uvicorn
from starlette.types import ASGIApp

from service.api.connections import LOG_EVERY_S, BoundedConfig, BoundedProtocol, Limits
from service.settings import Settings

log = structlog.get_logger(__name__)

#: connections that the system keeps until they are accepted
BACKLOG: Final = 1024
#: descriptors for everything but clients: the database, files, the loop itself
RESERVED_DESCRIPTORS: Final = 256
#: more are of no use, and what is started from here would inherit them
_ENOUGH_DESCRIPTORS: Final = 16_384
_FEWEST_CONNECTIONS: Final = 16
_NONE_LEFT: Final = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM})
_CANNOT_START: Final = 3
#: of the time that requests in flight get when the server stops: bodies may come for so long, and the rest is for what
#: has come of them
_BODIES: Final = 0.75


def serve(app: ASGIApp, settings: Settings, *, drain_s: int, on_stop: Callable[[], None]) -> None:
    """Run an application until it is told to stop; requests in flight then get ``drain_s`` seconds.

    When it is told, ``on_stop`` is called first, and for `Settings.stop_notice_s` everything is answered as before: who
    asks whether it is ready has time to learn that it is not, and sends nothing more.

    The settings are those that the application has, `with_room`. Raises `OSError` when the address cannot be had.
    """
    sockets = listen(settings.host, settings.port)
    for one in sockets:
        host, port = one.getsockname()[:2]
        log.info("listening", url=f"http://{f'[{host}]' if ':' in host else host}:{port}")
    server = make_server(app, settings, drain_s=drain_s)
    server.on_stop, server.notice_s = on_stop, settings.stop_notice_s
    # what is loaded stays: looked through for garbage, it holds up all requests for some 0.1 s every few hundred
    gc.collect()
    gc.freeze()
    server.run(sockets)
    if not server.started:
        sys.exit(_CANNOT_START)


def make_server(app: ASGIApp, settings: Settings, *, drain_s: int) -> Server:
    """A server with the limits of the settings, to be run with sockets."""
    config = BoundedConfig(
        app,
        Limits.of(settings),
        log_config=None,
        access_log=False,
        server_header=False,
        # how many connections asyncio accepts before it looks at any of them; `Server` listens with a queue of its own
        backlog=1,
        timeout_keep_alive=math.ceil(settings.idle_timeout_s),
        timeout_graceful_shutdown=drain_s,
    )
    return Server(config)


class Server(uvicorn.Server):
    """uvicorn's server on given sockets, which bears a lack of descriptors.

    asyncio tries to accept as many connections in a row as the queue is long, does not stop when the first fails for
    lack of descriptors, logs each failure and tries each again: a loop that keeps a core busy and fills the log. It is
    therefore told of a queue of one, while the sockets have a real one.
    """

    on_stop: Callable[[], None] = staticmethod(lambda: None)
    notice_s: float = 0.0

    async def main_loop(self) -> None:
        """Serve until told to stop, and a moment longer."""
        await super().main_loop()
        self.on_stop()
        until = time.monotonic() + self.notice_s
        while time.monotonic() < until and not self.force_exit:
            await asyncio.sleep(0.05)

    async def startup(self, sockets: Sequence[socket.socket] | None = None) -> None:
        """Begin to listen."""
        await super().startup(list(sockets or []))
        for one in sockets or ():
            one.listen(BACKLOG)
        asyncio.get_running_loop().set_exception_handler(_ExceptionLog())

    async def shutdown(self, sockets: Sequence[socket.socket] | None = None) -> None:
        """Let requests end; those whose body still comes some time before the others are cut off."""
        drain_s = self.config.timeout_graceful_shutdown or 0
        ends = asyncio.get_running_loop().call_later(drain_s * _BODIES, self._end_bodies)
        try:
            await super().shutdown(list(sockets or []))
        finally:
            ends.cancel()

    def _end_bodies(self) -> None:
        for one in self.server_state.connections:
            if isinstance(one, BoundedProtocol):
                one.end_body()


class _ExceptionLog:
    """asyncio's handler of exceptions, which says only now and then that there are no descriptors."""

    def __init__(self) -> None:
        self._last = -math.inf

    def __call__(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        error = context.get("exception")
        if not isinstance(error, OSError) or error.errno not in _NONE_LEFT:
            loop.default_exception_handler(context)
        elif time.monotonic() - self._last >= LOG_EVERY_S:
            log.error("no more connections can be accepted for now", error=error.strerror)
            self._last = time.monotonic()


def listen(host: str, port: int) -> list[socket.socket]:
    """Sockets at every address of a host, all at the same port; 0 picks one. Raises `OSError`."""
    found = socket.getaddrinfo(host or None, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    sockets: list[socket.socket] = []
    for family, address in dict.fromkeys((family, address) for family, _, _, _, address in found):
        # asyncio switches Nagle's algorithm off only where the protocol is named: with it, the end of an answer waits
        # for the client to acknowledge its beginning, which a client does 40 ms late
        one = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
        sockets.append(one)
        try:
            one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if family == socket.AF_INET6:
                one.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            one.bind((address[0], port, *address[2:]))
        except OSError as error:
            for opened in sockets:
                opened.close()
            raise OSError(error.errno, error.strerror, f"{address[0]}:{port}") from error
        port = one.getsockname()[1]
    return sockets


def with_room(settings: Settings) -> Settings:
    """The settings, with fewer connections where the system has no room for so many: shares of them are fewer, too."""
    return settings.model_copy(update={"max_connections": connection_limit(settings.max_connections)})


def connection_limit(wanted: int) -> int:
    """How many connections there is room for, at most ``wanted``, once the process has all descriptors it may have.

    A client over this limit takes the place of one that only waits, so that descriptors never run out.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard == resource.RLIM_INFINITY or hard > _ENOUGH_DESCRIPTORS:
        hard = _ENOUGH_DESCRIPTORS
    if soft != resource.RLIM_INFINITY and soft < hard:
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
        soft = hard
    room = wanted if soft == resource.RLIM_INFINITY else max(_FEWEST_CONNECTIONS, soft - RESERVED_DESCRIPTORS)
    if room < wanted:
        log.warning("fewer connections than PVG_MAX_CONNECTIONS: there are too few descriptors", connections=room)
    return min(room, wanted)
