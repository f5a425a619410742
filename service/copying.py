"""Copies of files, and of blobs to and from an object store, which whoever waits for them may end at any time."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Awaitable, Callable, Coroutine, Iterator
from contextlib import suppress
from contextvars import Context
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final, TypeVar, TypeVarTuple

import obstore
from obstore.exceptions import GenericError

if TYPE_CHECKING:
    from obstore.store import ObjectStore

T = TypeVar("T")
_Values = TypeVarTuple("_Values")

#: of a file that is read or copied: who has it done may end it between two
_PIECE_BYTES: Final = 4 * 1024**2
#: seconds between two looks at whether to go on, while a store is waited for
_LOOK_S: Final = 0.25
#: seconds for which a store that is given up on may take to end an upload, and of them those to say that it has begun,
#: or that a part has come: a worker that has to stop does not wait for longer
_LAST_S: Final = 5.0
_HEARD_S: Final = 4.0
_PART_BYTES: Final = 5 * 1024**2
#: S3 takes no more parts of one upload
_MAX_PARTS: Final = 10_000
#: each is held in memory while it is sent: together less than 50 MB
_PARTS_AT_ONCE: Final = 4


def go_on() -> None:
    """Nobody ends it."""


class _Loop(asyncio.SelectorEventLoop):
    """An event loop that nobody need be told of once it is closed.

    What an object store is asked goes on outside of it. Where an upload that is given up on ends only then, obstore
    would print a traceback for the answer that nobody waits for.
    """

    def call_soon_threadsafe(
        self, callback: Callable[[*_Values], object], *args: *_Values, context: Context | None = None
    ) -> asyncio.Handle:
        try:
            return super().call_soon_threadsafe(callback, *args, context=context)
        except RuntimeError:
            if not self.is_closed():
                raise
            return asyncio.Handle(callback, args, self)


def run(copying: Coroutine[Any, Any, None]) -> None:
    """Have `receive` or `send` done."""
    with asyncio.Runner(loop_factory=_Loop) as runner:
        runner.run(copying)


async def receive(store: ObjectStore, key: str, file: IO[bytes], check: Callable[[], None]) -> None:
    """Write a blob of an object store into a file, as long as ``check`` lets it.

    Raises `FileNotFoundError` when there is none.
    """
    found = await _watched(obstore.get_async(store, key), check)
    pieces = aiter(found.stream(min_chunk_size=_PIECE_BYTES))
    with suppress(StopAsyncIteration):
        while True:
            # with a default, what is waited for would be around the store's own answer, which nobody ended
            file.write(await _watched(anext(pieces), check))


async def send(store: ObjectStore, key: str, path: Path, check: Callable[[], None]) -> None:
    """Write a file into an object store, complete or not at all, as long as ``check`` lets it.

    Raises `GenericError` when the store does not take it, `FileNotFoundError` when its bucket is not there.
    """
    part = part_bytes(path.stat().st_size)
    writer = obstore.open_writer_async(store, key, buffer_size=part, max_concurrency=_PARTS_AT_ONCE)
    answering: asyncio.Future[int] | None = None
    try:
        for piece in _pieces_of(path, part, check):
            answering = asyncio.ensure_future(writer.write(piece))
            await _watched(asyncio.shield(answering), check)
    except BaseException as error:
        with suppress(Exception):  # it has the store forget the parts that it has
            await asyncio.wait_for(_end(writer, answering, error), _LAST_S)
        raise
    # an upload that is cut off here would leave its parts: the last few are sent
    closing = asyncio.ensure_future(writer.close())
    try:
        await _watched(asyncio.shield(closing), check)
    except FileNotFoundError:
        raise
    except OSError as error:  # obstore's errors come as such from here
        raise GenericError(str(error)) from error
    finally:
        await asyncio.wait([closing], timeout=_LAST_S)


async def _end(writer: obstore.AsyncWritableFile, answering: asyncio.Future[int] | None, error: BaseException) -> None:
    """Have a store forget an upload that ``error`` ends, once it has answered what it was asked last.

    An upload that is cut off while it begins is one whose name nobody has learnt, so nobody can end it.
    """
    if answering is not None:
        await asyncio.wait([answering], timeout=_HEARD_S)
        answering.cancel()
    await writer.__aexit__(type(error), error, error.__traceback__)


async def _watched(answer: Awaitable[T], check: Callable[[], None]) -> T:
    """What an object store answers. ``check`` is called while it is waited for, and ends that by raising."""
    waiting = asyncio.ensure_future(answer)
    try:
        while True:
            check()
            if (await asyncio.wait([waiting], timeout=_LOOK_S))[0]:
                return waiting.result()
    finally:
        waiting.cancel()


def part_bytes(size: int) -> int:
    """How large the parts are in which a file of this size goes to an object store."""
    return max(_PART_BYTES, -(-size // _MAX_PARTS))


def file_sha256(path: Path, check: Callable[[], None] = go_on) -> str:
    """The sha256 of a file as hex. ``check`` is called every few MiB, and ends it by raising."""
    digest = hashlib.sha256()
    for piece in _pieces_of(path, _PIECE_BYTES, check):
        digest.update(piece)
    return digest.hexdigest()


def copy(source: Path, target: Path, check: Callable[[], None]) -> None:
    """Write a file's bytes into another. ``check`` is called every few MiB, and ends it by raising."""
    with target.open("wb") as file:
        for piece in _pieces_of(source, _PIECE_BYTES, check):
            file.write(piece)


def read_through(path: Path) -> None:
    """Read a file to its end."""
    for _ in _pieces_of(path, _PIECE_BYTES, go_on):
        pass


def _pieces_of(path: Path, size: int, check: Callable[[], None]) -> Iterator[bytes]:
    """A file in pieces of so many bytes. ``check`` is called before each, and may raise."""
    with path.open("rb") as file:
        while piece := file.read(size):
            check()
            yield piece
