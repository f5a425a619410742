from __future__ import annotations

from typing import Any

import pytest
from sqlalchemy import event

from service.catalog import Database, Media, leases, media, sweep, tombstones
from service.catalog.models import Role
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
        assert sweep.expire_media(session, now=clock()) == [late.source_key]
        assert sweep.expire_media(session, now=clock()) == []
        assert {one.id for one in session.query(Media)} == {video.id, reference.id, vectorizing.id}


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
