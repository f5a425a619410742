"""Lines to the real service that break in the middle, and that remember what went over them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import httpx


@dataclass
class Line(httpx.BaseTransport):
    """A line on which each body, either way, is cut off after `cut_bytes`, as long as there are `cuts` left.

    The first `spared` requests pass whole.
    """

    cuts: int = 0
    cut_bytes: int = 0
    spared: int = 0
    #: method, path, and the Range or Upload-Offset of each request
    seen: list[tuple[str, str, str | None]] = field(default_factory=list)
    sent_bytes: int = 0
    received_bytes: int = 0

    def __post_init__(self) -> None:
        self._real = httpx.HTTPTransport()

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        begin = request.headers.get("range") or request.headers.get("upload-offset")
        self.seen.append((request.method, request.url.path, begin))
        assert isinstance(request.stream, httpx.SyncByteStream)
        body = _Cut(self, request.stream, sending=True)
        response = self._real.handle_request(
            httpx.Request(
                request.method, request.url, headers=request.headers, stream=body, extensions=request.extensions
            )
        )
        assert isinstance(response.stream, httpx.SyncByteStream)
        response.stream = _Cut(self, response.stream, sending=False)
        return response

    def close(self) -> None:
        self._real.close()

    def methods(self) -> list[str]:
        return [method for method, _, _ in self.seen]


class _Cut(httpx.SyncByteStream):
    def __init__(self, line: Line, stream: httpx.SyncByteStream, *, sending: bool) -> None:
        self._line, self._stream, self._sending = line, stream, sending

    def __iter__(self) -> Iterator[bytes]:
        passed = 0
        for data in self._stream:
            spared = self._line.cuts == 0 or len(self._line.seen) <= self._line.spared
            whole = spared or passed + len(data) < self._line.cut_bytes
            some = data if whole else data[: self._line.cut_bytes - passed]
            passed += len(some)
            if self._sending:
                self._line.sent_bytes += len(some)
            else:
                self._line.received_bytes += len(some)
            yield some
            if not whole:
                self._line.cuts -= 1
                raise httpx.WriteError("cut") if self._sending else httpx.ReadError("cut")

    def close(self) -> None:
        self._stream.close()


#: a medium as the service shows it
MEDIUM = {
    "id": "vid_1",
    "state": "vectorizing",
    "job": "job_1",
    "filename": "clip.mp4",
    "content_type": "video/mp4",
    "size_bytes": 10,
    "sha256": "0" * 64,
    "created_at": "2026-01-05T10:00:00Z",
    "expires_at": "2026-02-04T10:00:00Z",
}
