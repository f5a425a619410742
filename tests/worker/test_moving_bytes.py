"""A job that has to end while the bytes of its files are on their way."""

from __future__ import annotations

import asyncio
import selectors
import threading
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import obstore
import pytest

from service import copying
from service.blobs import Blobs
from service.storage import Storage
from tests.service.s3 import S3
from tests.service.servers import Wire
from tests.waiting import until
from tests.worker.test_publishing import run
from worker.lease import CanceledError
from worker.run import Run
from worker.unpublished import Unpublished

__all__ = ["run"]

KEY = "source/ab/clip.mp4"
CONTENT = bytes(24 * 2**20)


@pytest.fixture
def remote(run: Run, bucket: S3, wire: Wire) -> Run:
    """The same run with its files in a bucket, one of them there already."""
    storage = Storage(run.settings.model_copy(update={"storage_url": bucket.storage_url}))
    draft = storage.spool.draft()
    draft.write_bytes(CONTENT)
    storage.put(draft, KEY)
    return replace(run, storage=storage, blobs=Blobs(run.database, storage))


def ends_at(look: int) -> Callable[[], None]:
    """A check that says at this look, and from then on, that the job is canceled."""
    looks = count(1)
    return ends_when(lambda: next(looks) >= look)


def ends_when(reached: Callable[[], bool]) -> Callable[[], None]:
    """A check that says so as soon as this is true."""

    def check() -> None:
        if reached():
            raise CanceledError

    return check


def uploads(bucket: S3) -> list[str]:
    """What has begun to be stored, by its key."""
    return [one["Key"] for one in bucket.client().list_multipart_uploads(Bucket=bucket.bucket).get("Uploads", [])]


def drafts(run: Run) -> list[Path]:
    return [path for path in run.settings.spool_folder.iterdir() if path.is_file()]


@pytest.mark.timeout(60)  # a store is silent for longer before it is away
@pytest.mark.parametrize("silent", [False, True])
def test_a_file_is_not_fetched_to_its_end(
    remote: Run, wire: Wire, monkeypatch: pytest.MonkeyPatch, *, silent: bool
) -> None:
    monkeypatch.setattr(remote.keeper, "check", ends_at(4))
    if silent:
        wire.hang()
    with pytest.raises(CanceledError), remote.local_path(KEY):
        pass
    assert drafts(remote) == []


def test_what_the_store_was_asked_for_is_ended_with_the_job(remote: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Else it goes on, and comes to an event loop that is closed by then."""
    asked: list[asyncio.Future[bytes]] = []

    class Found:
        """A file of which nothing comes."""

        def stream(self, **_: Any) -> Found:
            return self

        def __aiter__(self) -> Found:
            return self

        def __anext__(self) -> asyncio.Future[bytes]:
            asked.append(asyncio.get_running_loop().create_future())
            return asked[-1]

    async def found(*_: Any) -> Found:
        return Found()

    monkeypatch.setattr(obstore, "get_async", found)
    monkeypatch.setattr(remote.keeper, "check", ends_when(lambda: asked != []))
    with pytest.raises(CanceledError), remote.local_path(KEY):
        pass
    assert [one.cancelled() for one in asked] == [True]


def test_a_file_that_is_fetched_while_the_job_goes_on_is_whole(remote: Run) -> None:
    with remote.local_path(KEY) as path:
        assert path.read_bytes() == CONTENT
    assert drafts(remote) == []


def test_a_large_file_is_not_read_to_its_end_before_it_is_stored(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run.keeper, "check", ends_at(4))
    made = run.draft_folder() / "look.mp4"
    made.write_bytes(CONTENT)
    with pytest.raises(CanceledError), Unpublished(run) as unpublished:
        unpublished.store("result", made, "res_1", ".mp4")
    assert made.exists()
    assert list(run.storage.entries()) == []


@pytest.mark.timeout(60)
def test_a_file_that_is_not_sent_to_its_end_leaves_nothing_in_the_store(
    remote: Run, bucket: S3, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(remote.keeper, "check", ends_when(lambda: uploads(bucket) != []))
    nothing_is_stored(remote, bucket)


@pytest.mark.timeout(60)
def test_nor_does_one_on_whose_way_the_store_falls_silent(
    remote: Run, bucket: S3, wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks = count(1)

    def silent_for_a_while() -> bool:
        if not uploads(bucket):
            return False
        wire.hang()
        if next(looks) < 6:
            return False
        wire.connect()
        return True

    monkeypatch.setattr(remote.keeper, "check", ends_when(silent_for_a_while))
    nothing_is_stored(remote, bucket)


@pytest.mark.timeout(60)
def test_nor_does_one_of_which_the_store_has_yet_to_say_that_it_began(
    remote: Run, bucket: S3, wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    wire.mute()

    def begun() -> bool:
        if not uploads(bucket):
            return False
        threading.Timer(0.5, wire.connect).start()
        return True

    monkeypatch.setattr(remote.keeper, "check", ends_when(begun))
    nothing_is_stored(remote, bucket)


class Skipped(selectors.DefaultSelector):
    """Waits for a moment only; the rest of the time it says has gone by."""

    skipped_s = 0.0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        found = super().select(None if timeout is None else min(timeout, 0.01))
        if not found:
            self.skipped_s += timeout or 0
        return found


class SkippingLoop(asyncio.SelectorEventLoop):
    """Its time is what it waits for that does not come, whatever time that really takes."""

    def __init__(self) -> None:
        self._skipped = Skipped()
        super().__init__(self._skipped)

    def time(self) -> float:
        return self._skipped.skipped_s


@pytest.mark.timeout(60)
def test_a_store_that_says_nothing_of_one_is_not_waited_for_twice(
    remote: Run, bucket: S3, wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For its answer and then for the end of the upload: a worker that has to stop is ended soon after."""
    silent: list[float] = []
    given_up: list[float] = []
    loop = SkippingLoop()
    monkeypatch.setattr(copying, "run", loop.run_until_complete)

    def silent_for_long() -> bool:
        if not silent and uploads(bucket):
            wire.hang()
            silent.append(loop.time())
        if not silent or loop.time() < silent[0] + 60:  # by then so many parts wait that it takes no more
            return False
        given_up.append(loop.time())
        return True

    made = remote.storage.spool.draft()
    made.write_bytes(2 * CONTENT)
    with closing(loop), pytest.raises(CanceledError):
        remote.storage.put(made, "result/ab/look.mp4", check=ends_when(silent_for_long))
    assert loop.time() - given_up[0] == pytest.approx(copying._LAST_S, abs=0.1)


@pytest.mark.timeout(60)
def test_nor_does_one_whose_last_parts_are_on_their_way(
    remote: Run, bucket: S3, monkeypatch: pytest.MonkeyPatch
) -> None:
    open_writer, closing = obstore.open_writer_async, []

    class Noted:
        """A writer that notes when it is closed."""

        def __init__(self, *args: Any, **options: Any) -> None:
            self._writer = open_writer(*args, **options)

        def __getattr__(self, name: str) -> Any:
            if name == "close":
                closing.append(self)
            return getattr(self._writer, name)

    monkeypatch.setattr(obstore, "open_writer_async", Noted)
    monkeypatch.setattr(remote.keeper, "check", ends_when(lambda: closing != []))
    nothing_is_stored(remote, bucket)
    assert len(closing) == 1


@pytest.mark.timeout(60)
def test_a_store_may_end_one_after_it_was_given_up_on(
    remote: Run, bucket: S3, wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    """obstore says so to an event loop that is closed by then, and prints a traceback where that raises."""
    open_writer, closed, heard = obstore.open_writer_async, threading.Event(), list[BaseException | None]()

    class Silent:
        """A writer whose store falls silent when it is closed."""

        def __init__(self, *args: Any, **options: Any) -> None:
            self._writer = open_writer(*args, **options)

        def __getattr__(self, name: str) -> Any:
            return getattr(self._writer, name)

        def close(self) -> Any:
            wire.hang()
            loop = asyncio.get_running_loop()
            tell = loop.call_soon_threadsafe

            def told(*args: Any, **options: Any) -> Any:
                try:
                    handle = tell(*args, **options)
                except BaseException as error:
                    heard.append(error)
                    raise
                heard.append(None)
                return handle

            monkeypatch.setattr(loop, "call_soon_threadsafe", told)
            closed.set()
            return self._writer.close()

    monkeypatch.setattr(obstore, "open_writer_async", Silent)
    monkeypatch.setattr(copying, "_LAST_S", 0.1)
    made = remote.storage.spool.draft()
    made.write_bytes(CONTENT)
    with pytest.raises(CanceledError):
        remote.storage.put(made, "result/ab/look.mp4", check=ends_when(closed.is_set))
    assert heard == []
    wire.connect()
    assert until(lambda: heard) == [None]
    assert bucket.read("faces/result/ab/look.mp4") == CONTENT


def nothing_is_stored(run: Run, bucket: S3) -> None:
    made = run.draft_folder() / "look.mp4"
    made.write_bytes(CONTENT)
    with pytest.raises(CanceledError), Unpublished(run) as unpublished:
        unpublished.store("result", made, "res_1", ".mp4")
    assert uploads(bucket) == []
    assert bucket.listed() == [f"faces/{KEY}"]


def test_a_file_that_is_sent_while_the_job_goes_on_is_whole(remote: Run, bucket: S3) -> None:
    made = remote.draft_folder() / "look.mp4"
    made.write_bytes(CONTENT)
    file = Unpublished(remote).store("result", made, "res_1", ".mp4")
    assert bucket.read(f"faces/{file.key}") == CONTENT
    assert not made.exists()
