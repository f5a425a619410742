from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta

from sqlalchemy.orm import Session

from service.catalog import Database, LookParams, Media, Preview, PreviewState, Role, StillRequest, media, previews
from service.catalog import still_request as request_of
from service.catalog.models import Tombstone
from service.catalog.previews import KEPT_S, Still
from tests.service.fixtures import FakeClock, add_media, held_up
from tests.waiting import until

REQUEST = StillRequest("jpeg", 640, frame=3, params=LookParams(faces=(0,), makeup={"lips": 1.0}), crop=(1, 2, 3, 4))


def ask(database: Database, video: Media, mark: str = "a", reference: Media | None = None) -> tuple[str, bool]:
    with database.write() as session:
        return ask_in(session, database, video, mark, reference)


def ask_in(
    session: Session, database: Database, video: Media, mark: str = "a", reference: Media | None = None
) -> tuple[str, bool]:
    preview, is_new = previews.ask(
        session,
        REQUEST,
        owner="",
        media_id=video.id,
        reference_id=None if reference is None else reference.id,
        fingerprint=mark,
        now=database.now(),
        within_s=10,
    )
    return preview.id, is_new


def take(database: Database, preview_id: str) -> Preview | None:
    with database.write() as session:
        return previews.take(session, preview_id, now=database.now(), within_s=10)


def finish(database: Database, preview_id: str, key: str = "preview/x") -> bool:
    with database.write() as session:
        return previews.finish(session, preview_id, Still(key, 10, 3))


def test_a_picture_is_asked_for_taken_and_made_once(database: Database) -> None:
    preview_id, is_new = ask(database, add_media(database))
    assert is_new
    taken = take(database, preview_id)
    assert taken is not None
    assert request_of(taken) == REQUEST
    assert take(database, preview_id) is None
    assert finish(database, preview_id)
    assert not finish(database, preview_id)
    with database.read() as session:
        (ended,) = previews.ended(session, [preview_id])
    assert (ended.state, ended.blob_key, ended.frame) == (PreviewState.DONE, "preview/x", 3)


def test_who_asks_for_the_same_soon_gets_the_same(database: Database, clock: FakeClock) -> None:
    video = add_media(database)
    first = ask(database, video)
    assert ask(database, video) == (first[0], False)
    assert ask(database, video, "b")[1]
    take(database, first[0])
    finish(database, first[0])
    clock.forward(15)
    assert ask(database, video) == (first[0], False)
    clock.forward(10)  # its bytes are about to go
    assert ask(database, video)[1]


def test_who_asks_at_the_same_time_gets_the_same_and_is_counted(database: Database) -> None:
    video = add_media(database)
    with ThreadPoolExecutor(2) as others:
        with database.write() as session:
            first = ask_in(session, database, video)
            same, another = others.submit(ask, database, video), others.submit(ask, database, video, "b")
            until(lambda: held_up(database) == 2)  # both have asked before the first one is recorded
            assert not same.done()
            assert not another.done()
        assert same.result(60) == (first[0], False)
        assert another.result(60)[1]
    with database.read() as session:
        assert previews.open_count(session, "", now=database.now(), within_s=10) == 2


def test_one_whose_worker_is_gone_is_not_waited_for(database: Database, clock: FakeClock) -> None:
    video = add_media(database)
    first, _ = ask(database, video)
    assert take(database, first) is not None
    clock.forward(9)
    assert ask(database, video) == (first, False)
    clock.forward(2)
    second, is_new = ask(database, video)
    assert is_new
    assert second != first


def test_one_that_failed_is_tried_again(database: Database) -> None:
    video = add_media(database)
    first, _ = ask(database, video)
    take(database, first)
    with database.write() as session:
        assert previews.fail(session, first, {"type": "media-invalid", "title": "x", "detail": "y"})
    assert ask(database, video)[1]


def test_a_request_that_nobody_waits_for_is_not_begun(database: Database, clock: FakeClock) -> None:
    preview_id, _ = ask(database, add_media(database))
    clock.forward(11)
    assert take(database, preview_id) is None
    other, _ = ask(database, add_media(database))
    with database.write() as session:
        previews.drop(session, other)
    assert take(database, other) is None


def test_the_record_outlives_the_bytes_and_then_goes(database: Database, clock: FakeClock) -> None:
    preview_id, _ = ask(database, add_media(database))
    clock.forward(KEPT_S + 5)
    with database.write() as session:
        assert previews.expire(session, now=database.now()) == 0
    clock.forward(60)
    with database.write() as session:
        assert previews.expire(session, now=database.now()) == 1
        assert previews.existing(session, [preview_id]) == set()


def test_deleting_either_medium_removes_the_picture(database: Database) -> None:
    for deleted in (0, 1):
        both = add_media(database), add_media(database, Role.REFERENCE)
        key = f"preview/{deleted}"
        preview_id, _ = ask(database, both[0], str(deleted), both[1])
        take(database, preview_id)
        finish(database, preview_id, key)
        late, _ = ask(database, both[0], f"late {deleted}", both[1])
        take(database, late)
        with database.write() as session:
            found = media.get(session, both[deleted].id)
            assert found is not None
            assert key in media.delete(session, found, now=database.now())
        with database.read() as session:
            tomb = session.get(Tombstone, key)
        assert tomb is not None
        assert tomb.due_at <= database.now() + timedelta(seconds=1)
        assert not finish(database, late)  # it was being made: its bytes are to be thrown away
