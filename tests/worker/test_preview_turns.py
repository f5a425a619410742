"""Whose picture is next."""

from __future__ import annotations

import socket
from pathlib import Path

import structlog

from service.catalog import Database, Media, Preview, StillRequest, previews
from service.settings import Settings
from tests.service.fixtures import FakeClock, add_media
from tests.service.servers import free_port
from worker.previews.previewer import Previewer
from worker.previews.turns import Turns
from worker.sandbox import Sandbox


def ask(database: Database, video: Media, mark: str) -> str:
    with database.write() as session:
        preview, is_new = previews.ask(
            session,
            StillRequest("jpeg", 640),
            owner=video.owner,
            media_id=video.id,
            reference_id=None,
            fingerprint=mark,
            now=database.now(),
            within_s=10,
        )
    assert is_new
    return preview.id


def begun(preview: Preview | None) -> Preview:
    assert preview is not None
    return preview


def test_a_clip_at_work_takes_one_thread_and_no_turn_is_lost(database: Database) -> None:
    turns, video, other = Turns(database, 10), add_media(database), add_media(database)
    first, second, third = (ask(database, video, mark) for mark in "abc")
    at_work = begun(turns.begin())
    assert at_work.id == first
    assert turns.begin() is None  # the message of the second, and that of the third
    assert turns.begin() is None
    elsewhere = ask(database, other, "d")
    also = begun(turns.begin())
    assert also.id == elsewhere
    assert turns.go_on() is None
    turns.end(at_work)
    for wanted in (second, third):
        at_work = begun(turns.go_on())
        assert at_work.id == wanted
        assert turns.go_on() is None
        turns.end(at_work)
    turns.end(also)
    assert turns.go_on() is None
    # what comes later has a message of its own
    ask(database, video, "e")
    assert turns.go_on() is None
    assert turns.begin() is not None


def test_a_key_with_many_requests_holds_up_none_of_another(database: Database) -> None:
    turns = Turns(database, 10)
    greedy = [ask(database, add_media(database, owner="key_a"), str(number)) for number in range(4)]
    modest = ask(database, add_media(database, owner="key_b"), "b")
    assert [begun(turns.begin()).id for _ in range(3)] == [greedy[0], modest, greedy[1]]


def test_what_nobody_waits_for_any_more_is_owed_nothing(database: Database, clock: FakeClock) -> None:
    turns, video = Turns(database, 10), add_media(database)
    ask(database, video, "a")
    at_work = begun(turns.begin())
    ask(database, video, "b")
    assert turns.begin() is None
    clock.forward(11)
    turns.end(at_work)
    assert turns.go_on() is None
    late = ask(database, video, "c")
    assert turns.go_on() is None
    assert begun(turns.begin()).id == late


def test_a_database_that_is_away_is_no_fault_of_a_picture(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path / "data", database_url=f"postgresql://pvg@127.0.0.1:{free_port()}/none")
    with socket.socket() as lobby, structlog.testing.capture_logs() as lines:
        Previewer(settings, Sandbox(lobby)).take_turn()
    assert [(line["event"], line["log_level"]) for line in lines] == [
        ("pictures are not made: what they need is away", "warning")
    ]
