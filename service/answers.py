"""What an answer of a server that others name may cost besides its bytes: each small piece of it costs as a large one.

A head may follow any number of interim answers (RFC 9110, 15.2), and a body come in chunks of a byte.
"""

from __future__ import annotations

import ssl
from collections.abc import AsyncIterator, Iterable
from typing import Any, Final

import httpcore
import httpx

#: of a head, with the interim answers before it
MAX_HEAD_BYTES: Final = 32 * 1024
#: pieces of a body, after which they have so many bytes on average; chunks are cut where a read ends
FREE_PIECES: Final = 1000
MIN_PIECE_BYTES: Final = 32


class BoundedTransport(httpx.AsyncHTTPTransport):
    """A transport for one answer at a time, whose head ends within `MAX_HEAD_BYTES`.

    Raises `httpx.RemoteProtocolError` for a longer one.
    """

    def __init__(self, tls: ssl.SSLContext) -> None:
        super().__init__(verify=tls, trust_env=False)
        self._head = _Head()
        self._pool = httpcore.AsyncConnectionPool(ssl_context=tls, network_backend=_Backend(self._head))

    async def handle_async_request(self, request: httpx.Request) -> httpx.Response:
        """Send the request; the head of its answer is there afterwards."""
        self._head.left_bytes = MAX_HEAD_BYTES
        response = await super().handle_async_request(request)
        self._head.left_bytes = None
        return response


async def pieces(response: httpx.Response) -> AsyncIterator[bytes]:
    """The body as it comes. Raises `httpx.RemoteProtocolError` when it comes in thousands of tiny pieces."""
    number = size_bytes = 0
    async for piece in response.aiter_raw():
        number, size_bytes = number + 1, size_bytes + len(piece)
        if number > FREE_PIECES and size_bytes < MIN_PIECE_BYTES * number:
            raise httpx.RemoteProtocolError("the answer comes in too many small pieces")
        yield piece


class _Head:
    """How many bytes more may come before the head has ended; None once it has."""

    left_bytes: int | None = None


class _Stream(httpcore.AsyncNetworkStream):
    """A connection that reads no more than is left for the head, until that has ended."""

    def __init__(self, stream: httpcore.AsyncNetworkStream, head: _Head) -> None:
        self._stream = stream
        self._head = head

    async def read(self, max_bytes: int, timeout: float | None = None) -> bytes:
        left_bytes = self._head.left_bytes
        if left_bytes is None:
            return await self._stream.read(max_bytes, timeout)
        if left_bytes == 0:
            raise httpcore.RemoteProtocolError(f"the head of the answer is longer than {MAX_HEAD_BYTES} bytes")
        data = await self._stream.read(min(max_bytes, left_bytes), timeout)
        self._head.left_bytes = left_bytes - len(data)
        return data

    async def write(self, buffer: bytes, timeout: float | None = None) -> None:
        await self._stream.write(buffer, timeout)

    async def aclose(self) -> None:
        await self._stream.aclose()

    async def start_tls(
        self,
        ssl_context: ssl.SSLContext,
        server_hostname: str | None = None,
        timeout: float | None = None,
    ) -> httpcore.AsyncNetworkStream:
        return _Stream(await self._stream.start_tls(ssl_context, server_hostname, timeout), self._head)

    def get_extra_info(self, info: str) -> Any:
        return self._stream.get_extra_info(info)


class _Backend(httpcore.AsyncNetworkBackend):
    """Makes such connections."""

    def __init__(self, head: _Head) -> None:
        self._backend = httpcore.AnyIOBackend()
        self._head = head

    async def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,
        local_address: str | None = None,
        socket_options: Iterable[httpcore.SOCKET_OPTION] | None = None,
    ) -> httpcore.AsyncNetworkStream:
        stream = await self._backend.connect_tcp(host, port, timeout, local_address, socket_options)
        return _Stream(stream, self._head)

    async def sleep(self, seconds: float) -> None:
        await self._backend.sleep(seconds)
