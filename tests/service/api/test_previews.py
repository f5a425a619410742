"""Single pictures over HTTP; a worker's steps are done by hand."""

from __future__ import annotations

import socket
import sys
import threading
import time
from collections.abc import AsyncIterator, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any

import pytest
from sqlalchemy import delete

from service.api.examples import MEDIUM
from service.blobs import Blobs
from service.catalog import Media, PreviewState, previews, workers
from service.catalog.models import Preview
from service.catalog.previews import KEPT_S, Still
from service.errors import Limit, stored_problem
from service.settings import Settings
from service.storage import BlobMissingError
from tests.folders import contents_below
from tests.service.fixtures import MP4, PNG, Api, FakeClock, make_ready, serve
from tests.waiting import until

#: of every clip here
FRAMES = MEDIUM["media"]["frame_count"]
#: seconds between two signs of life
BEAT_S = 1.0
#: what a worker has to do
OPEN = (PreviewState.ASKED, PreviewState.TAKEN)
PICTURE = b"\xff\xd8\xff the face of somebody"


@dataclass
class Made:
    """What a worker that is alive has made."""

    requests: list[dict[str, Any]] = field(default_factory=list)


@contextmanager
def preview_worker(api: Api, error: dict[str, Any] | None = None) -> Iterator[Made]:
    """A worker of previews, as the records see it."""
    services, stop, made = api.services, threading.Event(), Made()
    blobs = Blobs(services.background, services.storage, within_s=KEPT_S)

    def beat() -> float:
        with services.background.write() as session:
            workers.beat(session, "previews", now=services.background.now(), kind="previews")
        return time.monotonic()

    def work() -> None:
        beaten = time.monotonic()
        while not stop.wait(0.01):
            # it writes only where there is something to do: one that always does leaves SQLite's lock to nobody
            if time.monotonic() > beaten + BEAT_S:
                beaten = beat()
            with services.background.read() as session:
                if session.query(Preview).filter(Preview.state.in_(OPEN)).first() is None:
                    continue
            with services.background.write() as session:
                now = services.background.now()
                for row in session.query(Preview).filter(Preview.state == PreviewState.ASKED):
                    if previews.take(session, row.id, now=now, within_s=services.settings.preview_timeout_s) is None:
                        continue
                    made.requests.append(row.request)
                    if error is not None:
                        previews.fail(session, row.id, error)
            with services.background.read() as session:
                taken = session.query(Preview).filter(Preview.state == PreviewState.TAKEN).all()
            for row in taken:
                draft = services.storage.spool.draft()
                draft.write_bytes(PICTURE)
                key = services.storage.key("preview", "ab" * 32, row.id, ".jpg")
                blobs.put(draft, key)
                with services.background.write() as session:
                    previews.finish(session, row.id, Still(key, len(PICTURE), 5))

    beat()
    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield made
    finally:
        stop.set()
        thread.join()


@pytest.fixture
def video(api: Api) -> str:
    answer = api.client.post("/videos", content=MP4)
    assert answer.status_code == 202, answer.text
    video_id: str = answer.json()["id"]
    make_ready(api.services, video_id)
    return video_id


@pytest.fixture
def reference(api: Api) -> str:
    reference_id: str = api.client.post("/references", content=PNG).json()["id"]
    make_ready(api.services, reference_id)
    return reference_id


def body(video: str, reference: str, **more: Any) -> dict[str, Any]:
    return {"video": video, "look": {"reference": reference, **more.pop("look", {})}, **more}


def test_a_picture_is_made_and_shown(api: Api, video: str, reference: str) -> None:
    with preview_worker(api) as worker:
        answer = api.client.post("/preview", json=body(video, reference, nearest=True, look={"strength": 0.5}))
    assert (answer.status_code, answer.content) == (200, PICTURE)
    assert answer.headers["content-type"] == "image/jpeg"
    assert answer.headers["pvg-frame"] == "5"
    assert answer.headers["cache-control"] == "private, no-cache"
    (asked,) = worker.requests
    assert (asked["params"]["strength"], asked["nearest"], asked["before"]) == (0.5, True, False)


def test_the_same_is_made_once_and_is_304_for_who_has_it(api: Api, video: str, reference: str) -> None:
    with preview_worker(api) as worker:
        first = api.client.post("/preview", json=body(video, reference))
        again = api.client.post("/preview", json=body(video, reference))
        etag = {"If-None-Match": first.headers["etag"]}
        unchanged = api.client.post("/preview", json=body(video, reference), headers=etag)
        other = api.client.post("/preview", json=body(video, reference, look={"light": 0.1}), headers=etag)
    assert (again.status_code, again.content, again.headers["etag"]) == (200, PICTURE, first.headers["etag"])
    assert (unchanged.status_code, unchanged.content) == (304, b"")
    assert other.status_code == 200
    assert other.headers["etag"] != first.headers["etag"]
    assert len(worker.requests) == 2


def test_pictures_are_a_use_of_their_media_that_is_written_once_an_hour(api: Api, video: str, reference: str) -> None:
    services, full_s = api.services, api.services.settings.media_ttl_s

    def kept_until() -> list[datetime]:
        with services.database.read() as session:
            return [session.get_one(Media, one).expires_at for one in (video, reference)]

    def grow_old(seconds: float) -> list[datetime]:
        with services.background.write() as session:
            for one in (video, reference):
                session.get_one(Media, one).expires_at = services.database.now() + timedelta(seconds=full_s - seconds)
        return kept_until()

    with preview_worker(api):
        for ask in (
            lambda: api.client.post("/preview", json=body(video, reference)),
            lambda: [api.client.get(f"/{kind}/frames/0") for kind in (f"videos/{video}", f"references/{reference}")],
        ):
            young = grow_old(3000)
            ask()
            assert kept_until() == young
            old = grow_old(4000)
            ask()
            renewed = kept_until()
            assert all(new > then + timedelta(seconds=3900) for new, then in zip(renewed, old, strict=True))
            ask()
            assert kept_until() == renewed
        old = grow_old(4000)
        assert api.client.get(f"/videos/{video}/poster").status_code == 200
        assert kept_until() == old


def test_without_a_worker_it_is_said_at_once(api: Api, video: str, reference: str) -> None:
    with api.services.background.write() as session:
        workers.beat(session, "jobs", now=api.services.database.now())  # one of jobs makes no pictures
    for answer in (
        api.client.post("/preview", json=body(video, reference)),
        api.client.get(f"/videos/{video}/frames/0"),
    ):
        assert (answer.status_code, answer.json()["code"]) == (503, "unavailable")
        assert answer.headers["retry-after"] == "1"
        assert answer.headers["content-type"] == "application/problem+json"


def test_one_that_is_not_made_in_time_is_dropped(settings: Settings) -> None:
    for api in serve(settings.model_copy(update={"preview_timeout_s": 0.3})):
        video_id = api.client.post("/videos", content=MP4).json()["id"]
        make_ready(api.services, video_id)
        with api.services.background.write() as session:
            workers.beat(session, "previews", now=api.services.database.now(), kind="previews")
        answer = api.client.post("/preview", json={"video": video_id})
        assert (answer.status_code, answer.headers["retry-after"]) == (503, "1")
        with api.services.database.read() as session:
            assert session.query(Preview).count() == 0
        if api.services.settings.uses_broker_of_files:  # of Redis's, the worker passes over it
            messages = api.services.settings.folder / "broker" / "messages"
            assert [path for path in messages.iterdir() if "preview" in path.name] == []


def test_why_there_is_none_is_told(api: Api, video: str, reference: str) -> None:
    detail = "face 0 is not in frame 5"
    errors = [{"pointer": "/face", "detail": detail}]
    with preview_worker(api, stored_problem("validation-failed", detail, errors)):
        answer = api.client.post("/preview", json=body(video, reference, face=0))
    assert (answer.status_code, answer.json()["code"]) == (422, "validation-failed")
    assert (answer.json()["detail"], answer.json()["errors"]) == (detail, errors)


def test_one_that_needs_too_much_memory_is_422(api: Api, video: str, reference: str) -> None:
    problem = stored_problem("too-large", "the job needs more memory", limit=Limit(4e9, "bytes of memory"))
    with preview_worker(api, problem):
        answer = api.client.post("/preview", json=body(video, reference))
    assert (answer.status_code, answer.json()["status"], answer.json()["code"]) == (422, 422, "too-large")
    assert (answer.json()["limit"], answer.json()["unit"]) == (4e9, "bytes of memory")
    with preview_worker(api, stored_problem("insufficient-storage", "no room was left")):
        answer = api.client.get(f"/videos/{video}/frames/0")
    assert (answer.status_code, answer.json()["code"]) == (507, "insufficient-storage")


def test_what_may_go_well_later_is_to_be_asked_again(api: Api, video: str, reference: str) -> None:
    with preview_worker(api, stored_problem("unavailable", "the files could not be reached for too long")):
        answer = api.client.post("/preview", json=body(video, reference))
    assert (answer.status_code, answer.headers["retry-after"]) == (503, "1")


def test_media_that_are_not_ready_are_409(api: Api, video: str) -> None:
    late = api.client.post("/references", content=PNG).json()["id"]
    answer = api.client.post("/preview", json=body(video, late))
    assert (answer.status_code, answer.json()["code"]) == (409, "conflict")
    assert api.client.get(f"/references/{late}/poster").status_code == 409
    assert api.client.get(f"/references/{late}/frames/0").status_code == 409


def test_what_is_unknown_is_404(api: Api, video: str, reference: str) -> None:
    absent = "vid_" + "0" * 32
    assert api.client.post("/preview", json=body(absent, reference)).status_code == 404
    assert api.client.post("/preview", json=body(video, "ref_" + "0" * 32)).json()["errors"] == [
        {"pointer": "/look/reference", "detail": f"there is no reference ref_{'0' * 32}"}
    ]
    both = api.client.post("/preview", json=body(absent, absent)).json()["errors"]
    assert [one["pointer"] for one in both] == ["/video", "/look/reference"]
    for path in ("frames/0", "poster", "faces/0/thumbnail"):
        assert api.client.get(f"/videos/{absent}/{path}").status_code == 404
        assert api.client.get(f"/references/{video}/{path}").status_code == 404  # it is a video
    assert api.client.get(f"/videos/{video}/frames/{FRAMES}").status_code == 404
    assert api.client.get(f"/videos/{video}/faces/1/thumbnail").status_code == 404


@pytest.mark.parametrize(
    ("more", "pointer"),
    [
        ({"frame": FRAMES}, "/frame"),
        ({"time_s": 9}, "/time_s"),
        ({"face": 1}, "/face"),
        ({"look": {"faces": [1]}}, "/look/faces"),
        ({"look": {"reference_face": 1}}, "/look/reference_face"),
        ({"look": {"strength": 2}}, "/look/strength"),
        ({"crop": [0, 0, 0, 5]}, "/crop/2"),
        ({"max_width": 0}, "/max_width"),
        ({"max_width": 8193}, "/max_width"),
        ({"format": "gif"}, "/format"),
        ({"frame": 0, "time_s": 0}, "/time_s"),
        ({"face": 0, "crop": [0, 0, 5, 5]}, "/face"),
        ({"looks": []}, "/looks"),
        ({"frame": "0"}, "/frame"),
    ],
)
def test_what_does_not_fit_is_422(api: Api, video: str, reference: str, more: dict[str, Any], pointer: str) -> None:
    answer = api.client.post("/preview", json=body(video, reference, **more))
    assert (answer.status_code, answer.json()["errors"][0]["pointer"]) == (422, pointer), answer.text


def test_a_picture_may_be_as_wide_as_8k(api: Api, video: str, reference: str) -> None:
    with preview_worker(api) as worker:
        assert api.client.post("/preview", json=body(video, reference, max_width=8192)).status_code == 200
    assert [one["max_width"] for one in worker.requests] == [8192]


def test_a_reference_is_not_recoloured(api: Api, reference: str) -> None:
    answer = api.client.post("/preview", json={"video": reference})
    assert (answer.status_code, answer.json()["errors"][0]["pointer"]) == (422, "/video")
    late = api.client.post("/references", content=PNG).json()["id"]
    answer = api.client.post("/preview", json={"video": late})  # nor when it is vectorised: that is not waited for
    assert (answer.status_code, answer.json()["errors"][0]["pointer"]) == (422, "/video")
    assert answer.json()["detail"].startswith(f"{late} is a reference")


def test_unknown_layers_are_422_and_known_ones_asked_for(api: Api, video: str, reference: str) -> None:
    assert api.client.get(f"/videos/{video}/frames/0?layer=bones").status_code == 422
    with preview_worker(api) as worker:
        answer = api.client.get(f"/videos/{video}/frames/0?layer=matte")
        also = api.client.get(f"/references/{reference}/frames/0")
    assert (answer.status_code, answer.headers["content-type"], also.status_code) == (200, "image/png", 200)
    assert [(one["layer"], one["frame"], one["format"]) for one in worker.requests] == [
        ("matte", 0, "png"),
        ("image", 0, "png"),
    ]


@pytest.mark.parametrize("are_lost", [False, True])
def test_a_medium_of_before_or_whose_own_are_lost_gets_its_small_pictures_on_request(
    api: Api, video: str, *, are_lost: bool
) -> None:
    if are_lost:
        with api.services.background.write() as session:
            medium = session.get_one(Media, video)
            medium.pictures_key, medium.pictures = "pictures/00/lost.jpgs", [[None, 0, 5], [0, 5, 9]]
    shown = api.client.get(f"/videos/{video}").json()
    assert shown["poster"] == f"/v1/videos/{video}/poster"
    assert shown["faces"][0]["thumbnail"] == f"/v1/videos/{video}/faces/0/thumbnail"
    with preview_worker(api) as worker:
        poster, face = api.client.get(shown["poster"]), api.client.get(shown["faces"][0]["thumbnail"])
    assert (poster.status_code, face.status_code) == (200, 200)
    assert [(one["face"], one["max_width"]) for one in worker.requests] == [(None, 640), (0, 160)]


def add_poster(api: Api, video: str, content: bytes) -> None:
    """What a worker stores beside an asset."""
    draft = api.services.storage.spool.draft()
    draft.write_bytes(content)
    key = api.services.storage.key("pictures", "cd" * 32, video, ".jpgs")
    Blobs(api.services.background, api.services.storage).put(draft, key)
    with api.services.background.write() as session:
        medium = session.get_one(Media, video)
        medium.pictures_key, medium.pictures = key, [[None, 0, len(content)]]


@pytest.mark.parametrize("place", ["frames/0", "poster"])
def test_who_takes_a_picture_slowly_keeps_no_copy_of_it(
    api: Api, video: str, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    """Each connection kept a whole one in memory, and a key may have 250."""
    content = bytes(64 * 1024**2)
    monkeypatch.setattr(sys.modules[__name__], "PICTURE", content)
    add_poster(api, video, content)
    stream, taken = api.services.storage.stream, []

    async def counted(key: str, start: int, end: int) -> AsyncIterator[bytes]:
        pieces = await stream(key, start, end)

        async def each() -> AsyncIterator[bytes]:
            async for piece in pieces:
                taken.append(len(piece))
                yield piece

        return each()

    monkeypatch.setattr(api.services.storage, "stream", counted)
    with preview_worker(api), socket.create_connection(api.address, timeout=60) as reader:
        reader.sendall(f"GET /videos/{video}/{place} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode())
        head = b""
        while b"\r\n\r\n" not in head:
            head += reader.recv(1)
        time.sleep(1)
        assert sum(taken) < len(content) // 2
        rest = reader.makefile("rb").read()
    assert f"content-length: {len(content)}\r\n".encode() in head.lower()
    assert (len(rest), sum(taken)) == (len(content), len(content))


def test_a_picture_that_is_gone_before_its_first_byte_is_503(
    api: Api, video: str, reference: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def gone(key: str, start: int, end: int) -> AsyncIterator[bytes]:
        raise BlobMissingError(key)

    monkeypatch.setattr(api.services.storage, "stream", gone)
    with preview_worker(api):
        answer = api.client.post("/preview", json=body(video, reference))
    assert (answer.status_code, answer.headers["retry-after"]) == (503, "1")
    assert answer.json()["detail"] == "the picture is gone; ask again"


@pytest.mark.parametrize("place", ["frames/0", "poster"])
def test_pictures_have_a_length_an_etag_and_a_head(api: Api, video: str, place: str) -> None:
    add_poster(api, video, PICTURE)
    with preview_worker(api):
        answer, head = api.client.get(f"/videos/{video}/{place}"), api.client.head(f"/videos/{video}/{place}")
        etag = {"If-None-Match": answer.headers["etag"]}
        unchanged = api.client.get(f"/videos/{video}/{place}", headers=etag)
    assert (answer.status_code, answer.content, answer.headers["content-length"]) == (200, PICTURE, str(len(PICTURE)))
    assert (head.status_code, head.content, head.headers["content-length"]) == (200, b"", str(len(PICTURE)))
    assert (unchanged.status_code, unchanged.content) == (304, b"")


@pytest.mark.parametrize("role", ["videos", "references"])
def test_deleting_the_medium_removes_its_pictures_at_once(api: Api, video: str, reference: str, role: str) -> None:
    media = {"videos": video, "references": reference}
    with preview_worker(api):
        assert api.client.post("/preview", json=body(video, reference)).status_code == 200
        assert any(key.startswith("preview/") for key in api.blobs)
        assert api.client.delete(f"/{role}/{media.pop(role)}").status_code == 204
        # an answer waits for a store to delete, but not for ever
        until(lambda: not any(key.startswith("preview/") for key in api.blobs))
    with api.services.database.read() as session:
        assert session.query(Preview).count() == 0
    for other, medium in media.items():
        assert api.client.delete(f"/{other}/{medium}").status_code == 204
    until(lambda: api.blobs == [])


@pytest.mark.parametrize("role", ["videos", "references"])
def test_whoever_waits_for_a_picture_of_what_is_deleted_is_told_so(
    api: Api, video: str, reference: str, role: str
) -> None:
    with api.services.background.write() as session:  # a worker that is alive, and begins nothing
        workers.beat(session, "previews", now=api.services.database.now(), kind="previews")

    def is_asked() -> int:
        with api.services.background.read() as session:
            return session.query(Preview).count()

    with ThreadPoolExecutor() as threads:
        waiting = threads.submit(api.client.post, "/preview", json=body(video, reference))
        until(is_asked)
        assert api.client.delete(f"/{role}/{video if role == 'videos' else reference}").status_code == 204
        answer = waiting.result()
    assert (answer.status_code, answer.json()["code"]) == (404, "not-found")


def test_nothing_is_left_after_a_minute(api: Api, video: str, reference: str, clock: FakeClock) -> None:
    with preview_worker(api):
        assert api.client.post("/preview", json=body(video, reference)).status_code == 200
    assert any(key.startswith("preview/") for key in api.blobs)
    background, reaper = api.services.background, api.services.reaper
    real = background.now
    clock.time = real()  # the picture may have taken seconds
    background.now = clock  # type: ignore[method-assign]
    try:
        clock.forward(KEPT_S + 1)
        reaper.round()
        assert not any(key.startswith("preview/") for key in api.blobs)
        clock.forward(60)
        reaper.round()
    finally:
        background.now = real  # type: ignore[method-assign]
    with api.services.database.read() as session:
        assert session.query(Preview).count() == 0
    assert not any(PICTURE in content for content in contents_below(api.services.settings.folder))


def test_one_key_cannot_fill_the_queue(settings: Settings) -> None:
    for api in serve(settings.model_copy(update={"max_open_previews": 2, "preview_timeout_s": 60})):
        video_id = api.client.post("/videos", content=MP4).json()["id"]
        make_ready(api.services, video_id)
        with api.services.background.write() as session:
            workers.beat(session, "previews", now=api.services.database.now(), kind="previews")
        statuses: list[int] = []
        limits: list[tuple[float, str]] = []

        def ask(
            width: int,
            api: Api = api,
            video_id: str = video_id,
            statuses: list[int] = statuses,
            limits: list[tuple[float, str]] = limits,
        ) -> None:
            answer = api.client.post("/preview", json={"video": video_id, "max_width": width})
            statuses.append(answer.status_code)
            if answer.status_code == 429:
                limits.append((answer.json()["limit"], answer.json()["unit"]))

        threads = [threading.Thread(target=ask, args=(100 + i,)) for i in range(5)]
        for thread in threads:
            thread.start()
        until(lambda statuses=statuses: len(statuses) == 3)  # the others wait for as long as there is a record
        with api.services.background.write() as session:
            session.execute(delete(Preview))
        for thread in threads:
            thread.join()
        assert statuses[:3] == [429] * 3
        assert limits == [(2, "pictures")] * 3
        assert sorted(statuses) == [429, 429, 429, 503, 503]


def test_an_idempotency_key_gets_the_same_and_not_another(api: Api, video: str, reference: str) -> None:
    key = {"Idempotency-Key": "slider-1"}
    with preview_worker(api):
        first = api.client.post("/preview", json=body(video, reference), headers=key)
        again = api.client.post("/preview", json=body(video, reference), headers=key)
        other = api.client.post("/preview", json=body(video, reference, before=True), headers=key)
    assert (first.status_code, again.status_code, again.content) == (200, 200, PICTURE)
    assert (other.status_code, other.json()["code"]) == (422, "idempotency-key-reused")
