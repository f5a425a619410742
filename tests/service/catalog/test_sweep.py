from __future__ import annotations

from typing import Any

from sqlalchemy import event

from service.catalog import Database, media, sweep, tombstones
from service.catalog.models import Role
from tests.service.fixtures import add_media


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
