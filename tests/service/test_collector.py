"""Files without a record go; those of another database, and of a later state of this one, stay."""

from __future__ import annotations

import errno
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from sqlalchemy import text

from service import collector
from service.api import Services, make_services
from service.catalog import Database, collecting, sweep, tombstones
from service.collector import HaltedError
from service.ids import new_id
from service.settings import Settings
from service.storage import NotMountedError
from tests.service.fixtures import FakeClock, make_tables
from tests.side_by_side import at_once
from tests.waiting import until

DAY = 86_400.0


@contextmanager
def running(data_dir: Path, storage_url: str, clock: FakeClock, database_url: str = "") -> Iterator[Services]:
    settings = Settings(data_dir=data_dir, storage_url=storage_url, database_url=database_url)
    make_tables(settings.database)
    services = make_services(settings, clock=clock)
    yield services
    services.close()


@pytest.fixture(params=["folder", "s3"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Where blobs are: a folder, and a bucket below a prefix."""
    return str(tmp_path / "blobs") if request.param == "folder" else str(request.getfixturevalue("bucket").storage_url)


@pytest.fixture
def services(tmp_path: Path, store: str, clock: FakeClock) -> Iterator[Services]:
    with running(tmp_path / "data", store, clock) as services:
        yield services


def put(services: Services, *, known: bool, count: int = 1) -> list[str]:
    """Blobs, with a record or without."""
    keys = [services.storage.key("source", f"{number:064x}", new_id("vid"), ".mp4") for number in range(count)]
    for key in keys:
        draft = services.storage.spool.draft()
        draft.write_bytes(b"a face")
        services.storage.put(draft, key)
    if known:
        with services.background.write() as session:
            for key in keys:
                tombstones.expect(session, key, now=services.background.now(), within_s=1000 * DAY)
    return keys


def kept(services: Services) -> set[str]:
    return {key for key, _ in services.storage.entries()}


def collect(services: Services) -> int:
    found = services.collector.collect()
    services.reaper.delete()
    return found


def halted(services: Services) -> str | None:
    with services.database.read() as session:
        return collecting.halted(session)


def refused(services: Services) -> str:
    """Why nothing is collected, and that it is not."""
    before = kept(services)
    with pytest.raises(HaltedError) as error:
        collect(services)
    services.reaper.delete()
    assert kept(services) == before
    assert halted(services) == error.value.why
    return error.value.why


def test_old_files_without_a_record_go(services: Services, clock: FakeClock) -> None:
    known, unknown = put(services, known=True, count=3), put(services, known=False)
    assert collect(services) == 0, "they may be of an upload that goes on"
    clock.forward(DAY)
    assert collect(services) == 1
    assert kept(services) == set(known)
    assert unknown[0] not in kept(services)


def test_pieces_of_blobs_go_without_a_search_and_no_round_of_jobs_waits_for_it(
    tmp_path: Path, clock: FakeClock
) -> None:
    with running(tmp_path / "data", str(tmp_path / "blobs"), clock) as services:
        collect(services)
        piece = tmp_path / "blobs" / ".incoming" / "piece"
        piece.parent.mkdir(exist_ok=True)
        piece.write_bytes(b"half of a face")
        services.collector._round()
        assert piece.exists(), "somebody may be writing it"
        clock.forward(2 * DAY)
        services.reaper.round()
        assert piece.exists(), "a folder that hangs would hold up what a round does for jobs"
        services.collector.start()
        until(lambda: not piece.exists())
        services.collector.stop()


def test_a_new_store_is_marked_at_the_first_search(services: Services, clock: FakeClock) -> None:
    assert services.storage.mark() is None
    assert collect(services) == 0
    with services.database.read() as session:
        assert services.storage.mark() == str(collecting.mark(session))
    assert kept(services) == set(), "the mark is no blob"
    put(services, known=False)
    clock.forward(DAY)
    assert collect(services) == 1


def test_what_has_another_form_than_our_keys_is_not_ours(
    services: Services, clock: FakeClock, request: pytest.FixtureRequest, store: str
) -> None:
    """Such as the other contents of a bucket that is given without a prefix."""
    others = ["photos/2024/me.jpg", "source/ab/notes.txt", f"staging/source/00/{'0' * 64}-vid_{'0' * 32}.mp4"]
    for name in others:
        if store.startswith("s3"):
            bucket = request.getfixturevalue("bucket")
            bucket.client().put_object(Bucket=bucket.bucket, Key=f"faces/{name}", Body=b"x")
        else:
            (Path(store) / name).parent.mkdir(parents=True, exist_ok=True)
            (Path(store) / name).write_bytes(b"x")
    put(services, known=False)
    known = put(services, known=True)
    clock.forward(DAY)
    assert collect(services) == 1
    assert kept(services) == {*others, *known}


def test_files_of_another_database_stay(services: Services, store: str, clock: FakeClock, tmp_path: Path) -> None:
    """A wrong or an empty database, or staging and production with one prefix."""
    files = put(services, known=True, count=30)
    collect(services)
    with running(tmp_path / "other", store, clock) as other:
        clock.forward(DAY)
        assert refused(other) == "another-database"
        own = put(other, known=True, count=100)  # most are its own now
        assert refused(other) == "another-database"
        assert other.collector.adopt() == (130, 30)
        assert halted(other) is None
        clock.forward(DAY)
        assert collect(other) == 30
        assert kept(other) == set(own)
        assert refused(services) == "another-database"
    assert len(files) == 30


def test_files_of_nobody_knows_whom_stay(services: Services, clock: FakeClock) -> None:
    """A store of a version that did not mark it, and a database that is not the one it had."""
    put(services, known=False, count=3)
    put(services, known=True, count=2)
    clock.forward(DAY)
    assert refused(services) == "unknown-files"
    assert services.storage.mark() is None
    services.collector.adopt()
    assert collect(services) == 3


def test_files_that_are_newer_than_a_backup_that_was_restored_stay(
    services: Services, clock: FakeClock, tmp_path: Path, store: str
) -> None:
    put(services, known=True, count=50)
    collect(services)
    services.background.forget()
    shutil.copy(services.settings.folder / "catalog.sqlite3", tmp_path / "backup.sqlite3")
    clock.forward(DAY)
    collect(services)
    newer = put(services, known=True, count=5)
    clock.forward(DAY)
    (tmp_path / "restored").mkdir()
    shutil.copy(tmp_path / "backup.sqlite3", tmp_path / "restored" / "catalog.sqlite3")
    with running(tmp_path / "restored", store, clock) as restored:
        for _ in range(3):  # it does not catch up by trying
            assert refused(restored) == "older-database"
        assert collect(services) == 0, "the database that was there before may be taken back"
        assert restored.collector.adopt() == (55, 5)
        clock.forward(DAY)
        assert collect(restored) == 5
        assert not kept(restored) & set(newer)


def test_more_than_half_of_all_files_go_only_when_it_is_said(
    services: Services, clock: FakeClock, caplog: pytest.LogCaptureFixture
) -> None:
    collect(services)
    known = put(services, known=True, count=21)
    put(services, known=False, count=22)
    clock.forward(DAY)
    assert refused(services) == "most-files"
    services.collector.start()  # by itself, it says so
    until(lambda: "they are 22 of 43" in caplog.text)
    assert "gc --even-most" in caplog.text
    assert services.collector.collect(even_most=True) == 22
    services.reaper.clear()
    services.collector.stop()
    assert kept(services) == set(known)
    assert halted(services) is None


@pytest.mark.parametrize("mark", ["", "nonsense", "1 2 3", "\udcff"])
def test_a_mark_that_is_damaged_is_not_ours(services: Services, mark: str) -> None:
    services.storage.set_mark(mark.encode(errors="replace").decode())
    assert refused(services) == "another-database"


def test_of_several_processes_one_searches(
    services: Services, clock: FakeClock, monkeypatch: pytest.MonkeyPatch, store: str
) -> None:
    searches: list[Services] = []
    with running(services.settings.data_dir, store, clock) as second:
        for one in (services, second):
            monkeypatch.setattr(one.collector, "collect", lambda one=one: searches.append(one))
        for one in (second, services, second):
            one.collector.collect_when_due()
        assert searches == [second]
        clock.forward(6 * 3600)
        for one in (services, second):
            one.collector.collect_when_due()
        assert searches == [second, services]


def test_every_page_is_buried_by_itself(services: Services, clock: FakeClock, monkeypatch: pytest.MonkeyPatch) -> None:
    """No transaction is as long as the store is large."""
    monkeypatch.setattr(sweep, "BATCH", 4)
    monkeypatch.setattr(collector, "_HANDFUL", 100)
    buried: list[int] = []
    bury = tombstones.bury
    monkeypatch.setattr(
        tombstones, "bury", lambda session, keys, *, now: (buried.append(len(keys)), bury(session, keys, now=now))
    )
    collect(services)
    put(services, known=False, count=10)
    clock.forward(DAY)
    assert services.collector.collect() == 10
    assert buried == [4, 4, 2]


def test_jobs_do_not_wait_for_a_search(services: Services, monkeypatch: pytest.MonkeyPatch) -> None:
    asked, go_on = threading.Event(), threading.Event()

    def slow() -> Iterator[tuple[str, object]]:
        asked.set()
        go_on.wait(60)
        yield from ()

    monkeypatch.setattr(services.storage, "entries", slow)
    services.collector.start()
    try:
        assert asked.wait(60)
        services.reaper.round()
        assert services.reaper.idle_s < 60
    finally:
        go_on.set()
        services.collector.stop()


def test_a_round_that_fails_is_no_whole_round(services: Services, monkeypatch: pytest.MonkeyPatch) -> None:
    services.reaper._whole_at -= 1000
    monkeypatch.setattr(services.reaper, "revive", lambda: 1 / 0)
    monkeypatch.setattr(services.reaper.revive, "__name__", "revive", raising=False)
    services.reaper.round()
    assert services.reaper.idle_s > 900
    monkeypatch.undo()
    services.reaper.round()
    assert services.reaper.idle_s < 900


@pytest.mark.parametrize("store", ["folder"], indirect=True)
def test_a_folder_that_is_not_mounted_is_no_empty_store(services: Services, store: str, clock: FakeClock) -> None:
    keys = put(services, known=True)
    collect(services)
    Path(store).rename(f"{store}-disk")
    Path(store).mkdir()
    clock.forward(DAY)
    with running(Path(services.settings.data_dir), store, clock) as fresh:  # which has seen no mark
        for one in (services, fresh):
            with pytest.raises(NotMountedError):
                one.collector.collect()
            draft = one.storage.spool.draft()
            draft.write_bytes(b"a face")
            with pytest.raises(NotMountedError):
                one.storage.put(draft, keys[0])
        assert list(Path(store).iterdir()) == []
        Path(store).rmdir()
        Path(f"{store}-disk").rename(store)
        assert collect(fresh) == 0
    assert kept(services) == set(keys)


def test_a_first_mark_that_cannot_be_written_is_none_that_is_missed(
    services: Services, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: str) -> None:
        raise OSError(errno.ENOSPC, "no room")

    monkeypatch.setattr(services.storage, "set_mark", full)
    with pytest.raises(OSError, match="no room"):
        collect(services)
    monkeypatch.undo()
    services.storage.check_mounted()
    assert collect(services) == 0


@pytest.mark.parametrize("store", ["folder"], indirect=True)
def test_a_folder_that_has_lost_its_mark_is_adopted(services: Services, store: str) -> None:
    keys = put(services, known=True)
    collect(services)
    Path(store, ".database").unlink()
    with pytest.raises(NotMountedError):
        services.storage.ping()
    assert services.collector.adopt() == (1, 0)
    services.storage.ping()
    assert kept(services) == set(keys)


def test_a_database_has_one_id_however_many_ask_at_once(database: Database) -> None:
    def ask() -> str:
        with database.write() as session:
            return collecting.mark(session).database_id

    assert len(set(at_once([ask] * 4))) == 1
    with database.read() as session:
        assert session.execute(text("SELECT count(*) FROM collections")).scalar_one() == 1
