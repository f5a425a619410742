"""What a rendering job stores and publishes, without any drawing."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from datetime import timedelta
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy.exc import OperationalError
from sqlalchemy.orm import Session

from service.blobs import Blobs
from service.catalog import Database, Look, LookParams, Media, Report, Result, jobs, media, results, utc_now
from service.catalog.models import Tombstone
from service.catalog.requests import to_json
from service.settings import Settings
from service.storage import Storage
from tests.service.fixtures import add_media, add_transfer, announce, claim, job_of, make_tables
from tests.service.servers import free_port
from tests.waiting import until
from worker import vectorizing
from worker.answers import MediaAnswer, VectorizeAnswer
from worker.failures import OptionError, problem_of
from worker.lease import CanceledError, LeaseKeeper, LeaseLostError
from worker.needed import wanted
from worker.patience import Patience
from worker.progress import ProgressScale
from worker.publishing import DrawnExtra, DrawnLook, names_of_files, publish
from worker.run import Run
from worker.sandbox import Sandbox
from worker.stopping import StoppedError


@pytest.fixture
def run(settings: Settings) -> Iterator[Run]:
    """A claimed transfer of one look."""
    make_tables(settings.database)
    database = Database(settings.database, clock=utc_now)
    medium = add_media(database)
    lease = claim(database, medium.job_id)
    with database.write() as session:
        announce(session, "asset/x")
        media.finish(session, lease, media.Asset("asset/x", 1, {}, [], []), now=utc_now(), timings={})
    job_id = add_transfer(database, medium, medium)
    with database.write() as session:
        jobs.release(session, now=utc_now())
    lease = claim(database, job_id)
    job = job_of(database, job_id)
    with LeaseKeeper(database, lease, settings) as keeper, socket.socket() as unused:
        storage = Storage(settings)
        run = Run(
            settings=settings,
            database=database,
            storage=storage,
            blobs=Blobs(database, storage),
            job=job,
            lease=lease,
            keeper=keeper,
            progress=ProgressScale(keeper.report),
            sandbox=Sandbox(unused),
            patience=Patience(keeper.check, limit_s=60),
        )
        with run.drafts:
            yield run
    database.close()


def drawn(run: Run) -> tuple[list[DrawnLook], dict[str, Media]]:
    """The look as a file, with a cube of two persons and a matte in a folder of drafts."""
    with run.database.read() as session:
        (look,) = jobs.looks(session, run.job.id)
        medium = media.get(session, look.video_id)
    assert medium is not None
    folder = run.draft_folder()
    extras = (
        DrawnExtra("look.cube", 1, write(folder / "look-1.cube")),
        DrawnExtra("look.cube", 2, write(folder / "look-2.cube")),
        DrawnExtra("matte", 1, write(folder / "matte-1.mkv")),
    )
    report = Report("landmarks", "table")
    return [DrawnLook(look, write(folder / "look-0.mp4"), report, extras)], {medium.id: medium}


def test_two_looks_of_one_portrait_are_published_under_two_names(run: Run) -> None:
    (first,), present = drawn(run)
    (again,), _ = drawn(run)
    with run.database.write() as session:
        second = Look(job_id=run.job.id, position=1, params=first.look.params)
        second.video_id, second.reference_id = first.look.video_id, first.look.reference_id
        session.add(second)
    assert publish(run, [first, replace(again, look=second)], present)
    with run.database.read() as session:
        names = [result.filename for result in session.query(Result).order_by(Result.position, Result.id)]
    assert [names[0], names[4]] == ["clip-clip.mp4", "clip-clip-2.mp4"]
    assert names[5:] == [name.replace("clip-clip", "clip-clip-2") for name in names[1:4]]


def grow_old(run: Run, media_id: str) -> None:
    """Have the time of a medium be over, as while a job of it waits for long."""
    with run.database.write() as session:
        session.get_one(Media, media_id).expires_at = utc_now() - timedelta(seconds=60)


def left_s(run: Run, media_id: str) -> float:
    """For how long a medium is kept from now on."""
    with run.database.read() as session:
        return (session.get_one(Media, media_id).expires_at - utc_now()).total_seconds()


def test_results_of_a_job_that_took_longer_than_its_media_are_kept_have_their_time(run: Run) -> None:
    looks, present = drawn(run)
    (media_id,) = present
    grow_old(run, media_id)
    assert publish(run, looks, present)
    assert left_s(run, media_id) > run.settings.media_ttl_s - 60
    with run.database.read() as session:
        until_s = [
            (until - utc_now()).total_seconds()
            for until in results.kept_until(session, session.query(Result).all()).values()
        ]
    assert len(until_s) == 4
    assert min(until_s) > run.settings.result_ttl_s - 60


def test_a_job_that_publishes_nothing_is_no_use_of_its_media(run: Run) -> None:
    looks, present = drawn(run)
    (media_id,) = present
    grow_old(run, media_id)
    with run.database.write() as session:
        assert jobs.cancel(session, run.job.id, now=utc_now())
    with suppress(CanceledError):
        assert not publish(run, looks, present)
    assert left_s(run, media_id) < 0


def test_a_medium_that_was_vectorised_for_longer_than_it_is_kept_has_its_time(run: Run) -> None:
    medium = add_media(run.database)
    lease = claim(run.database, medium.job_id)
    grow_old(run, medium.id)
    with run.database.write() as session:
        announce(session, "asset/y")
    vectorized = replace(run, job=job_of(run.database, medium.job_id), lease=lease)
    assert vectorizing._finish(vectorized, media.Asset("asset/y", 1, {}, [], [])) == []
    assert left_s(run, medium.id) > run.settings.media_ttl_s - 60


def names_of(run: Run, looks: list[tuple[str, str]], *, extras: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """What the files of looks are called, of media with these names: each result's, then those of its extras."""
    folder, made, present = run.draft_folder(), [], {}
    for position, names in enumerate(looks):
        ids = [f"{role}_{name}" for role, name in zip(("vid", "ref"), names, strict=True)]
        present |= {one: Media(id=one, filename=name) for one, name in zip(ids, names, strict=True)}
        look = Look(position=position, video_id=ids[0], reference_id=ids[1])
        files = tuple(DrawnExtra("matte", 1, folder / name) for name in extras)
        made.append(DrawnLook(look, folder / f"look-{position}.mkv", Report("landmarks", "table"), files))
    named = names_of_files(made[::-1], present)  # by the order of the looks, not by that of the videos
    return [named[position] for position in range(len(looks))]


def test_files_of_one_job_have_names_of_their_own_in_the_order_of_the_looks(run: Run) -> None:
    one, other = ("clip.mp4", "portrait.jpg"), ("clip.mp4", "other.jpg")
    assert names_of(run, [one]) == [("clip-portrait.mkv",)]
    assert names_of(run, [one, other, one, one]) == [
        ("clip-portrait.mkv",),
        ("clip-other.mkv",),
        ("clip-portrait-2.mkv",),
        ("clip-portrait-3.mkv",),
    ]
    assert names_of(run, [one, one], extras=("look.cube", "matte.mkv")) == [
        ("clip-portrait.mkv", "clip-portrait-look.cube", "clip-portrait-matte.mkv"),
        ("clip-portrait-2.mkv", "clip-portrait-2-look.cube", "clip-portrait-2-matte.mkv"),
    ]


def test_a_number_leads_to_no_name_that_another_look_has_of_itself(run: Run) -> None:
    names = [("clip.mp4", name) for name in ("a.jpg", "A.png", "a-2.jpg", "a-matte.jpg")]
    assert [files[0] for files in names_of(run, names)] == [
        "clip-a.mkv",
        "clip-A-3.mkv",  # folders there are that tell no case
        "clip-a-2.mkv",
        "clip-a-matte.mkv",
    ]
    assert [files[0] for files in names_of(run, names, extras=("matte.mkv",))][3] == "clip-a-matte-2.mkv"
    composed, apart = "\u00e9", "e\u0301"
    assert names_of(run, [("clip.mp4", composed), ("clip.mp4", apart)])[1] == (f"clip-{apart}-2.mkv",)


def test_names_that_are_the_same_once_they_are_cut_have_a_number(run: Run) -> None:
    looks = [("微" * 100 + ".mp4", "ж" * 81 + letter) for letter in "ab"]
    stem = f"{'微' * 80}-{'ж' * 80}"
    assert names_of(run, looks) == [(f"{stem}.mkv",), (f"{stem}-2.mkv",)]


def write(path: Path) -> Path:
    path.write_bytes(path.name.encode())
    return path


@pytest.mark.parametrize(
    ("params", "error"),
    [
        (LookParams(reference_face=9), ("/looks/0/reference_face", "no face 9; this reference has faces 0 to 1")),
        (LookParams(faces=(0, 2)), ("/looks/0/faces", "no face 2; this clip has faces 0 to 1")),
        (LookParams(faces=(0, 1), reference_face=1), None),
    ],
)
def test_a_face_that_was_not_known_to_be_missing_is_named_where_it_was_asked_for(
    run: Run, params: LookParams, error: tuple[str, str] | None
) -> None:
    with run.database.write() as session:
        (look,) = jobs.looks(session, run.job.id)
        look.params = to_json(params)
        session.get_one(Media, look.video_id).faces = [{"index": 0}, {"index": 1}]
    if error is None:
        assert [one.position for one in wanted(run)[0]] == [0]
        return
    with pytest.raises(OptionError) as raised:
        wanted(run)
    problem = problem_of(raised.value)
    assert (problem["type"], problem["detail"]) == ("validation-failed", error[1])
    assert problem["errors"] == [{"pointer": error[0], "detail": error[1]}]


def test_a_result_and_its_parts_are_published_at_once(run: Run) -> None:
    assert publish(run, *drawn(run))
    with run.database.read() as session:
        (look,) = session.query(Look).all()
        assert look.result_id is not None
        parts = results.parts(session, [look.result_id])
        assert [(part.part, part.person, part.filename) for part in parts] == [
            ("look.cube", 1, "clip-clip-look-1.cube"),
            ("look.cube", 2, "clip-clip-look-2.cube"),
            ("matte", 1, "clip-clip-matte-1.mkv"),
        ]
        keys = {row.blob_key for row in session.query(Result).all()}
    assert len(keys) == 4
    assert {key for key, _ in run.storage.entries()} == keys


@pytest.mark.parametrize("when", ["before", "while"])
def test_nothing_stays_of_a_job_that_lost_its_lease(run: Run, when: str, monkeypatch: pytest.MonkeyPatch) -> None:
    made = drawn(run)

    def revoke() -> None:
        with run.database.write() as session:
            assert jobs.revoke(session, run.job.id, now=utc_now())

    stored = []
    put = run.storage.put

    def counted(path: Path, key: str, **more: Any) -> None:
        put(path, key, **more)
        stored.append(key)
        if len(stored) == 3:
            if when == "while":
                raise LeaseLostError
            revoke()

    monkeypatch.setattr(run.storage, "put", counted)
    if when == "while":
        with pytest.raises(LeaseLostError):
            publish(run, *made)
    else:
        with suppress(LeaseLostError):  # from the lease's keeper, if it is faster
            assert not publish(run, *made)
    until(lambda: not list(run.storage.entries()))  # a store that takes its time is not waited for
    with run.database.read() as session:
        assert session.query(Result).count() == 0
    folder = made[0][0].extras[0].path.parent
    run.drafts.close()
    assert not folder.exists()


def test_an_end_whose_answer_is_lost_is_recognised(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    made = drawn(run)
    write, lost = run.database.write, []

    @contextmanager
    def interrupted() -> Iterator[Session]:
        with write() as session:
            yield session
        if not lost:
            lost.append(True)
            raise OperationalError("COMMIT", {}, ConnectionError(), connection_invalidated=True)

    monkeypatch.setattr(run.database, "write", interrupted)
    assert publish(run, *made)
    with run.database.read() as session:
        keys = {row.blob_key for row in session.query(Result).all()}
    assert lost
    assert len(keys) == 4
    assert {key for key, _ in run.storage.entries()} == keys


def test_a_job_waits_for_an_object_store_that_is_away(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    port = free_port()
    for name, value in (("ACCESS_KEY_ID", "x"), ("SECRET_ACCESS_KEY", "x"), ("ALLOW_HTTP", "true")):
        monkeypatch.setenv(f"AWS_{name}", value)
    monkeypatch.setenv("AWS_ENDPOINT", f"http://127.0.0.1:{port}")
    away = Storage(run.settings.model_copy(update={"storage_url": "s3://bucket"}))
    taken: list[bytes] = []

    class Bucket(BaseHTTPRequestHandler):
        def do_PUT(self) -> None:
            taken.append(self.rfile.read(int(self.headers["Content-Length"])))
            self.send_response(200)
            self.send_header("ETag", '"1"')
            self.send_header("Content-Length", "0")
            self.end_headers()

    def come_back() -> None:
        with HTTPServer(("127.0.0.1", port), Bucket) as server:
            while not taken:
                server.handle_request()

    timer = threading.Timer(1, come_back)
    timer.daemon = True
    timer.start()
    file = write(tmp_path / "a.mp4")
    run.patience(lambda: away.put(file, "result/a.mp4"))
    timer.join()
    assert taken == [b"a.mp4"]
    assert not file.exists()
    (line,) = [record for record in caplog.records if record.msg == "waiting for what is away"]
    assert vars(line)["reason"] == "HTTP error: error sending request"


@pytest.mark.parametrize("end", [LeaseLostError, CanceledError, StoppedError])
def test_nothing_stays_of_a_vectorisation_that_ends_between_its_two_files(
    run: Run, end: type[Exception], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = run.draft_folder()
    for name in ("asset.pvg", "pictures.jpgs"):
        write(folder / name)
    with run.database.read() as session:
        medium = session.query(Media).one()
    stored, put = [], run.storage.put

    def noted(path: Path, key: str, **more: Any) -> None:
        put(path, key, **more)
        stored.append(key)

    def stops() -> None:
        if stored:
            raise end

    monkeypatch.setattr(run.storage, "put", noted)
    monkeypatch.setattr(run.keeper, "check", stops)
    shown: Any = {"kind": "video", "frame_rate": 25.0, "frame_count": 1, "duration_s": 1.0, "codec": "h264"}
    shown |= {"width": 1, "height": 1, "pixel_format": "yuv420p", "has_audio": False, "rotation": 0, "color": "bt709"}
    shown |= {"color_primaries": 1, "color_transfer": 1, "warnings": []}
    answer = VectorizeAnswer(media=MediaAnswer(**shown), pictures=[], faces=[], output=None)
    with pytest.raises(end):
        vectorizing._publish(run, medium, folder, answer)
    assert [key.split("/")[0] for key in stored] == ["asset"]
    until(lambda: not list(run.storage.entries()))

    def left() -> int:
        with run.database.read() as session:  # of which each sees the records as they are then
            return session.query(Tombstone).filter(Tombstone.blob_key.like("asset/%")).count()

    until(lambda: not left())


def test_what_a_killed_worker_stored_goes_with_its_lease(run: Run) -> None:
    file = write(run.draft_folder() / "look-0.mp4")
    run.blobs.put(file, "result/x", lease=run.lease)
    assert run.blobs.sweep() == 0
    with run.database.write() as session:
        assert jobs.revoke(session, run.job.id, now=utc_now())
    assert run.blobs.sweep() == 1
    assert not list(run.storage.entries())
