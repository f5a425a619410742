from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from sqlalchemy import Connection, event

from service.catalog import Database, Lease, Media, leases, media, parts, results, sweep, tombstones
from service.catalog.models import Result, Role, Tombstone
from tests.service.fixtures import FakeClock, add_media, add_transfer, claim


def test_media_that_are_needed_do_not_keep_others_waiting(
    database: Database, clock: FakeClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sweep, "BATCH", 1)
    video, reference, vectorizing, late = (add_media(database, content=str(i).encode()) for i in range(4))
    for medium in (video, reference, late):
        lease = claim(database, medium.job_id)
        with database.write() as session:
            assert leases.succeed(session, lease, now=clock(), timings={})
    add_transfer(database, video, reference)
    clock.forward(10_000_000)
    with database.write() as session:
        assert sweep.late_media(session, now=clock()) == [late.id]
        assert sweep.expire_medium(session, late.id, now=clock()) == [late.source_key]
        assert sweep.late_media(session, now=clock()) == []
        assert sweep.expire_medium(session, video.id, now=clock()) == []
        assert {one.id for one in session.query(Media)} == {video.id, reference.id, vectorizing.id}


@pytest.fixture
def statements(database: Database) -> Iterator[list[int]]:
    """How many parameters each statement has that was sent."""
    sent: list[int] = []

    def note(*said: Any) -> None:
        many = said[5]
        sent.append(max(map(len, said[3]), default=0) if many else len(said[3]))

    event.listen(database._engine, "before_cursor_execute", note)
    yield sent
    event.remove(database._engine, "before_cursor_execute", note)


@contextmanager
def scans(database: Database) -> Iterator[list[str]]:
    """Where the plans of the statements that are sent read a whole table of records, and those of a row each time."""
    found: list[str] = []
    engine = database._engine
    is_server = engine.dialect.name == "postgresql"
    explain = "EXPLAIN" if is_server else "EXPLAIN QUERY PLAN"
    wholes = re.compile(
        r"Seq Scan on (?:looks|results|media)\b|SubPlan" if is_server else r"SCAN (?:looks|results|media)\b"
    )

    def note(connection: Connection, cursor: Any, statement: str, parameters: Any, *_: Any) -> None:
        if statement.startswith(("SELECT", "UPDATE", "DELETE")):
            look = connection.connection.cursor()
            if is_server:  # small tables are read as a whole where there is a choice
                look.execute("SET LOCAL enable_seqscan = off")
            look.execute(f"{explain} {statement}", parameters)
            found.extend(f"{row}: {statement}" for row in look.fetchall() if wholes.search(str(row)))

    event.listen(engine, "before_cursor_execute", note)
    yield found
    event.remove(engine, "before_cursor_execute", note)


def test_what_goes_is_found_without_reading_all_records(database: Database, clock: FakeClock) -> None:
    medium, other = (add_media(database, content=name) for name in (b"one", b"other"))
    for one in (medium, other):
        add_results(database, one, 2)
    with database.write() as session, scans(database) as found:
        late = session.get_one(Result, f"{medium.id}-0")
        assert results.drop_bytes(session, late, now=clock()) == late.blob_key
        assert len(results.delete(session, f"{medium.id}-1", now=clock())) == 1
        assert len(media.delete(session, session.get_one(Media, other.id), now=clock())) == 3
        assert sweep.known_keys(session, [medium.source_key, "source/none"]) == {medium.source_key}
    assert found == []


def test_old_jobs_are_told_from_those_of_kept_results_and_media_one_by_one(
    database: Database, clock: FakeClock
) -> None:
    """A list of all that is kept fits into a server's memory no more at some hundred thousand results."""
    kept, made = (add_media(database, content=name) for name in (b"kept", b"made"))
    for one in (kept, made):
        assert end(database, claim(database, one.job_id))
    add_results(database, made, 1)
    with database.write() as session:
        session.delete(session.get_one(Media, made.id))
    clock.forward(1)
    with scans(database) as found:
        with database.write() as session:
            assert sweep.expire_jobs(session, before=clock()) == 0
        with database.write() as session:
            results.drop_bytes(session, session.get_one(Result, f"{made.id}-0"), now=clock())
            assert sweep.expire_jobs(session, before=clock()) == 1
    assert found == []


def end(database: Database, lease: Lease) -> bool:
    with database.write() as session:
        return leases.succeed(session, lease, now=database.now(), timings={})


def add_results(database: Database, medium: Media, count: int) -> None:
    """Results of a medium, as if a job had made that many of them."""
    with database.write() as session:
        for number in range(count):
            name = f"{medium.id}-{number}"
            session.add(
                Result(
                    **{"id": name, "job_id": medium.job_id, "position": number, "blob_key": f"result/{name}"},
                    **{"video_id": medium.id, "reference_id": medium.id, "sha256": "0" * 64, "size_bytes": 1},
                    **{"content_type": "video/mp4", "filename": "a.mp4", "created_at": database.now()},
                    expires_at=database.now(),
                )
            )


def test_a_medium_of_many_results_goes_by_few_statements(database: Database, statements: list[int]) -> None:
    """A server refuses one of more than 65,535 parameters, and SQLite has one writer at a time."""
    medium, other = (add_media(database, content=name) for name in (b"many", b"few"))
    add_results(database, medium, 700)
    add_results(database, other, 1)
    statements.clear()
    with database.write() as session:
        keys = media.delete(session, session.merge(medium), now=database.now())
    assert len(keys) == 701
    assert max(statements) <= 510
    assert len(statements) < 40
    with database.read() as session:
        assert [one.video_id for one in session.query(Result)] == [other.id]
        assert session.query(Tombstone).count() == 701


def test_the_blobs_of_many_jobs_are_asked_for_some_at_a_time(database: Database, statements: list[int]) -> None:
    ids = [f"job_{number}" for number in range(2000)]
    with database.read() as session:
        assert tombstones.written_for(session, ids) == parts.files_of(session, ids) == []
        assert parts.messages(session, ids) == []
    assert max(statements) <= 1010


def test_a_key_that_is_recorded_while_the_sweep_looks_is_known(database: Database) -> None:
    """Just before the tombstones are read its tombstone goes, and a record names it instead."""
    medium = add_media(database, Role.REFERENCE)
    with database.write() as session:
        tombstones.expect(session, "source/new", now=database.now(), within_s=900)

    moved = []

    def move(*said: Any) -> None:
        if "tombstones" in said[2] and not moved:
            moved.append(True)
            with database.write() as session:
                found = media.get(session, medium.id)
                assert found is not None
                media.replace_source(session, found, "source/new", now=database.now())

    with database.read() as session:
        event.listen(database._engine, "before_cursor_execute", move)
        assert sweep.known_keys(session, ["source/new", "source/other"]) == {"source/new"}
