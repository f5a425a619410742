from __future__ import annotations

from functools import partial

from sqlalchemy import func, select

from service.catalog import (
    DEFAULT_VECTOR_SETTINGS,
    Database,
    ResumableUpload,
    Role,
    UploadPart,
    amounts,
    keys,
    media,
    resumable,
    sweep,
    tombstones,
)
from tests.service.fixtures import FakeClock, add_media, announce
from tests.side_by_side import at_once


def begin(database: Database, size_bytes: int | None = 300, owner: str = "") -> str:
    with database.write() as session:
        made = resumable.create(
            session,
            Role.VIDEO,
            DEFAULT_VECTOR_SETTINGS,
            owner=owner,
            limit_bytes=1000,
            now=database.now(),
            ttl_s=100,
            size_bytes=size_bytes,
            metadata={"order": "42"},
        )
    return made.id


def append(database: Database, upload_id: str, start: int, key: str, *, ttl_s: float = 100) -> bool:
    with database.write() as session:
        announce(session, key)
    with database.write() as session:
        now = database.now()
        return resumable.append(session, upload_id, start=start, size_bytes=100, blob_key=key, now=now, ttl_s=ttl_s)


def blobs_to_delete(database: Database) -> set[str]:
    with database.read() as session:
        return set(tombstones.due(session, now=database.now(), limit=100))


def test_pieces_count_when_they_are_the_next(database: Database) -> None:
    upload = begin(database)
    assert append(database, upload, 0, "part/a")
    assert not append(database, upload, 0, "part/b")
    assert not append(database, upload, 200, "part/c")
    assert append(database, upload, 100, "part/d")
    with database.read() as session:
        assert [(part.start_bytes, part.blob_key) for part in resumable.parts(session, upload)] == [
            (0, "part/a"),
            (100, "part/d"),
        ]
        found = resumable.get(session, upload, now=database.now())
        assert found is not None
        assert (found.offset_bytes, found.metadata_) == (200, {"order": "42"})
        assert resumable.get(session, upload, owner="key_other", now=database.now()) is None
        # a search for files without a record leaves the pieces alone
        assert sweep.known_keys(session, ["part/a", "part/d", "part/x"]) == {"part/a", "part/d"}


def test_of_many_that_write_the_same_bytes_one_is_kept(database: Database) -> None:
    upload = begin(database)
    kept = at_once([partial(append, database, upload, 0, f"part/{n}") for n in range(8)])
    assert sorted(kept) == [False] * 7 + [True]


def test_the_pieces_go_with_the_medium_and_the_record_with_its_deletion(database: Database) -> None:
    upload = begin(database)
    append(database, upload, 0, "part/a")
    video = add_media(database)
    with database.write() as session:
        found = resumable.get(session, upload, now=database.now(), lock=True)
        assert found is not None
        resumable.close(session, found, media_id=video.id, size_bytes=300, now=database.now())
    assert "part/a" in blobs_to_delete(database)
    assert not append(database, upload, 300, "part/b")
    with database.read() as session:
        assert session.scalar(select(func.count()).select_from(UploadPart)) == 0
    with database.write() as session:
        medium = media.get(session, video.id)
        assert medium is not None
        media.delete(session, medium, now=database.now())
    with database.read() as session:
        assert resumable.get(session, upload, now=database.now()) is None


def test_an_upload_lives_from_its_last_piece(database: Database, clock: FakeClock) -> None:
    upload, other = begin(database), begin(database)
    clock.forward(90)
    assert append(database, upload, 0, "part/a")
    clock.forward(90)
    assert append(database, upload, 100, "part/b")
    assert not append(database, other, 0, "part/c")
    clock.forward(101)
    with database.write() as session:
        assert sweep.expire_uploads(session, now=database.now()) == 2
    assert {"part/a", "part/b"} <= blobs_to_delete(database)
    with database.read() as session:
        assert session.scalar(select(func.count()).select_from(UploadPart)) == 0


def test_the_size_is_said_once(database: Database) -> None:
    upload = begin(database, None)
    with database.write() as session:
        found = resumable.get(session, upload, now=database.now())
        assert found is not None
        assert resumable.begin(session, found, size_bytes=300, filename="a.mp4", said=None)
        assert not resumable.begin(session, found, size_bytes=400, filename="b.mp4", said=None)
        assert (found.size_bytes, found.filename) == (300, "a.mp4")


def test_what_is_arriving_counts_with_its_whole_length_until_it_is_a_medium(database: Database) -> None:
    limits = keys.Limits(requests_per_minute=1, active_jobs=1, stored_bytes=1)
    before = begin(database)
    with database.write() as session:
        key, _ = keys.create(session, "studio", limits, now=database.now())
    begin(database, None, owner=key.id)
    with database.read() as session:  # nothing is free when it ends
        assert (amounts.stored_bytes(session, key.id), amounts.next_expiry(session, key.id)) == (0, None)
    upload = begin(database, owner=key.id)
    with database.read() as session:
        assert amounts.stored_bytes(session, key.id) == 300
        assert amounts.next_expiry(session, key.id) is not None
    with database.write() as session:
        found = resumable.get(session, upload, now=database.now())
        assert found is not None
        resumable.close(session, found, media_id="vid_0", size_bytes=300, now=database.now())
    with database.write() as session:
        assert amounts.stored_bytes(session, key.id) == 0
        # what nobody began is given with the rest
        keys.adopt(session, key)
    with database.read() as session:
        assert resumable.get(session, before, owner=key.id, now=database.now()) is not None


def test_an_upload_stays_with_the_medium_that_it_has_become(database: Database) -> None:
    with database.write() as session:
        key, _ = keys.create(session, "studio", keys.Limits(), now=database.now())
    add_media(database, content=b"same", owner=key.id)
    stays, goes = add_media(database, content=b"same"), add_media(database, content=b"other")
    of = {medium.id: begin(database) for medium in (stays, goes)}
    with database.write() as session:
        for media_id, upload in of.items():
            found = session.get_one(ResumableUpload, upload)
            resumable.close(session, found, media_id=media_id, size_bytes=300, now=database.now())
    with database.write() as session:
        assert keys.adopt(session, key) == (1, 1)
    with database.read() as session:
        owners = [session.get_one(ResumableUpload, of[medium.id]).owner for medium in (stays, goes)]
    assert owners == ["", key.id]


def test_many_blobs_are_buried_at_once_those_that_are_known_too(database: Database, clock: FakeClock) -> None:
    names = [f"part/{number}" for number in range(1200)]
    with database.write() as session:
        tombstones.expect(session, names[0], now=clock(), within_s=900)
        tombstones.bury(session, [*names, names[1]], now=clock())
        tombstones.bury(session, names, now=clock())
    with database.read() as session:
        assert set(tombstones.due(session, now=clock(), limit=2000)) == set(names)


def test_what_has_not_arrived_is_listed_newest_first(database: Database, clock: FakeClock) -> None:
    late = begin(database)
    clock.forward(50)
    complete, first, link = begin(database), begin(database), begin(database, size_bytes=None)
    begin(database, owner="key_a")
    medium = add_media(database)
    with database.write() as session:
        found = resumable.get(session, complete, now=clock())
        assert found is not None
        resumable.close(session, found, media_id=medium.id, size_bytes=300, now=clock())

    def listed(before: str | None = None, limit: int = 10) -> list[str]:
        with database.read() as session:
            return [one.id for one in resumable.page(session, "", before=before, limit=limit, now=clock())]

    assert listed() == [link, first, late]
    assert listed(limit=1) == [link]
    assert listed(before=first) == [late]
    clock.forward(51)
    assert listed() == [link, first]
