"""Long renders in parts, by the real service: the same bytes whoever draws them, whatever happens meanwhile."""

from __future__ import annotations

import hashlib
import json
import signal
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import datetime
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from pvg.video import probe, read_frames
from scripts.samples import Samples
from service.settings import Settings
from tests.folders import files_below
from tests.service.servers import fresh_database
from tests.waiting import until
from tests.worker.serving import Service, kill_all, processes_of, running_service, sandboxed
from worker.parts import part_bounds

QUICK = {
    **{"heartbeat_s": "1", "reap_interval_s": "1", "progress_interval_s": "0.2"},
    **{"part_s": "5", "min_face_px": "32"},
}
FRAMES, SIZE, RATE = 160, (320, 180), Fraction(6)
BETWEEN = part_bounds(FRAMES, float(RATE), part_s=5.0)
#: so many that much of the job is left when a test comes in its middle, on a machine that stands still now and then too
PARTS = 5

pytestmark = pytest.mark.timeout(1800)

#: what happens to processes and files is the same wherever records are kept; `tests/service/catalog` has these on both
embedded = pytest.mark.parametrize(
    "setting", ["embedded", pytest.param("scaled", marks=pytest.mark.slow)], indirect=True, scope="module"
)


@pytest.fixture(scope="module")
def clip(samples: Samples, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A woman, forwards and backwards again and again, small, with sound: 160 frames, five parts of 5 s or more."""
    path = tmp_path_factory.mktemp("clips") / "long.mp4"
    there = [frame.rgb() for frame in read_frames(samples.woman_clip)]
    back_and_forth = [*there, *reversed(there)]
    with av.open(str(path), "w") as output:
        pictures = output.add_stream("libx264", rate=RATE, options={"crf": "16", "preset": "veryfast"})
        pictures.width, pictures.height, pictures.pix_fmt = *SIZE, "yuv420p"
        sound = output.add_stream("aac", rate=48_000, layout="mono")
        for number in range(FRAMES):
            picture = av.VideoFrame.from_ndarray(back_and_forth[number % len(back_and_forth)], format="rgb24")
            output.mux(pictures.encode(picture.reformat(*SIZE, format="yuv420p")))
        output.mux(pictures.encode())
        tone = np.sin(2 * np.pi * 440 / 48_000 * np.arange(48_000 * FRAMES // int(RATE))).astype(np.float32)
        for start in range(0, len(tone) - 1023, 1024):
            piece = av.AudioFrame.from_ndarray(0.1 * tone[None, start : start + 1024], format="fltp", layout="mono")
            piece.sample_rate, piece.pts, piece.time_base = 48_000, start, Fraction(1, 48_000)
            output.mux(sound.encode(piece))
        output.mux(sound.encode())
    return path


@pytest.fixture(scope="module", params=["embedded", "scaled"])
def setting(request: pytest.FixtureRequest) -> Iterator[dict[str, str]]:
    """Where records and messages are kept: one after the other, services start on the same."""
    if request.param == "embedded":
        yield {}
        return
    broker = request.getfixturevalue("redis_url")
    with fresh_database(request.getfixturevalue("postgres_url")) as database:
        yield {"broker_url": broker, "database_url": database}


@pytest.fixture(scope="module")
def folder(setting: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("service")


@pytest.fixture(scope="module")
def service(setting: dict[str, str], folder: Path) -> Iterator[Service]:
    """With two slots for jobs, that are single-threaded on two cores."""
    with running_service(folder, worker_concurrency="2", **QUICK, **setting) as running:
        yield running


@pytest.fixture(scope="module")
def wanted(service: Service, clip: Path, samples: Samples) -> dict[str, Any]:
    """A transfer of two looks, whose media are ready."""
    video = service.ready("/videos", clip)
    references = [service.ready("/references", one) for one in (samples.dark_portrait, samples.pale_portrait)]
    looks = [{"reference": reference["id"]} for reference in references]
    return {"video": video["id"], "looks": looks, "output": {"preset": "ultrafast"}, "force": True}


def asked(service: Service, wanted: dict[str, Any]) -> str:
    return str(service.client.post("/transfer", json=wanted).raise_for_status().json()["id"])


def begun(service: Service, whole_id: str) -> Counter[str]:
    """How often each share of a job was begun, by kind and id."""
    return Counter(f"{line['kind']} {line['job']}" for line in service.events("job begins", part_of=whole_id))


def digests(service: Service, done: dict[str, Any]) -> list[str]:
    assert done["state"] == "succeeded", done
    found = []
    for look in done["looks"]:
        content = service.client.get(f"/results/{look['result']}").raise_for_status().content
        found.append(hashlib.sha256(content).hexdigest())
        assert found[-1] == look["sha256"]
    return found


def drawn_files(service: Service) -> list[Path]:
    return files_below(service.data_dir / "blobs" / "drawn")


def until_gone(service: Service) -> None:
    until(lambda: not drawn_files(service), 120, said=lambda: str(drawn_files(service)))


@pytest.fixture(scope="module")
def plain(service: Service, wanted: dict[str, Any]) -> dict[str, Any]:
    """The job as two processes do it when nothing happens."""
    return service.finished(asked(service, wanted), 600)


def test_a_long_clip_is_drawn_in_parts_and_joined(
    service: Service, wanted: dict[str, Any], clip: Path, plain: dict[str, Any], tmp_path: Path
) -> None:
    assert len(BETWEEN) == PARTS + 1
    kinds = Counter(name.split()[0] for name in begun(service, plain["id"]).elements())
    assert kinds == {"part": PARTS, "join": 1}
    progress = plain["progress"]
    assert (progress["fraction"], progress["frames_done"], progress["frames_total"]) == (1.0, FRAMES, FRAMES)
    assert {"queued_s", "render_s", "join_s", "store_s"} <= {k for k, v in plain["timings"].items() if v is not None}
    source = probe(clip)
    for number, look in enumerate(plain["looks"]):
        path = tmp_path / f"{number}.mp4"
        path.write_bytes(service.client.get(f"/results/{look['result']}").raise_for_status().content)
        made = probe(path)
        assert (made.frame_count, made.width, made.height, made.has_audio) == (FRAMES, *SIZE, True)
        assert abs(made.duration_s - source.duration_s) < 0.1
    until_gone(service)
    # nothing of the parts is to be seen
    listed = service.client.get("/jobs?limit=100").json()["data"]
    assert {job["kind"] for job in listed} <= {"vectorize", "transfer"}
    part = next(iter(begun(service, plain["id"]))).split()[1]
    assert service.client.get(f"/jobs/{part}").status_code == 404
    assert service.client.post(f"/jobs/{part}/cancel").status_code == 404


@embedded
def test_a_part_whose_process_is_killed_is_drawn_again_and_no_other(
    service: Service, wanted: dict[str, Any], plain: dict[str, Any]
) -> None:
    job_id = asked(service, wanted)
    service.at_work(job_id)
    known = set(sandboxed(service))
    kill_all([max(until(lambda: set(sandboxed(service)) - known))])  # as it begins: one before may be about to end
    done = service.finished(job_id, 600)
    assert digests(service, done) == digests(service, plain)
    assert done["attempt"] == 2
    assert sorted(begun(service, job_id).values()) == [*[1] * PARTS, 2]
    until_gone(service)


@embedded
def test_a_part_that_is_lost_before_the_join_has_the_job_begin_anew(
    service: Service, wanted: dict[str, Any], plain: dict[str, Any]
) -> None:
    until_gone(service)
    job_id = asked(service, wanted)
    until(lambda: drawn_files(service), 300)[0].unlink()
    done = service.finished(job_id, 600)
    assert digests(service, done) == digests(service, plain)
    assert done["attempt"] == 2
    assert Counter(name.split()[0] for name in begun(service, job_id).elements()) == {"part": 2 * PARTS, "join": 2}
    until_gone(service)


def test_a_job_in_parts_is_canceled_mid_way(service: Service, wanted: dict[str, Any]) -> None:
    job_id = asked(service, wanted)
    service.at_work(job_id)
    assert service.client.post(f"/jobs/{job_id}/cancel").status_code == 202
    done = service.finished(job_id)
    assert (done["state"], done["error"]["title"]) == ("canceled", "The work was canceled")
    until_gone(service)
    until(lambda: not sandboxed(service))
    assert not [name for name in begun(service, job_id) if name.startswith("join")]


@embedded
def test_progress_rises_and_a_short_job_passes_a_long_one(
    service: Service, wanted: dict[str, Any], samples: Samples
) -> None:
    portrait = service.ready("/videos", samples.portrait)
    short = {"video": portrait["id"], "looks": wanted["looks"][:1], "force": True}
    job_id = asked(service, wanted)
    service.at_work(job_id)
    passing = asked(service, short)
    seen: list[tuple[float, int]] = []
    while not (body := service.job(job_id))["done"]:
        seen.append((body["progress"]["fraction"], body["progress"]["frames_done"]))
        time.sleep(0.1)
    (joined,) = [line["timestamp"] for line in service.events("job begins", part_of=job_id) if line["kind"] == "join"]
    passed = service.finished(passing)["finished_at"]
    assert datetime.fromisoformat(passed) < datetime.fromisoformat(joined)
    assert seen == sorted(seen)
    assert len({fraction for fraction, _ in seen}) > 3


@embedded
def test_one_process_gives_the_same_bytes_as_two(
    setting: dict[str, str], folder: Path, wanted: dict[str, Any], plain: dict[str, Any], service: Service
) -> None:
    """The last of this file: it stops the service with two slots."""
    expected = digests(service, plain)
    service.process.send_signal(signal.SIGINT)
    service.process.wait(120)
    until(lambda: not processes_of(service.data_dir))
    with ExitStack() as stack:
        alone = stack.enter_context(running_service(folder, worker_concurrency="1", **QUICK, **setting))
        done = alone.finished(asked(alone, wanted), 600)
        assert digests(alone, done) == expected
        assert sorted(begun(alone, done["id"]).values()) == [1] * (PARTS + 1)
        until_gone(alone)
        # of a video that is deleted meanwhile, nothing is left
        job_id = asked(alone, wanted)
        alone.at_work(job_id)
        until(lambda: drawn_files(alone), 300)
        assert alone.client.delete(f"/videos/{wanted['video']}?cancel_jobs=true").status_code == 204
        assert alone.job(job_id)["state"] == "canceled"
        until_gone(alone)


def test_where_parts_begin_is_what_the_settings_and_the_clip_say() -> None:
    assert BETWEEN == (0, 32, 64, 96, 128, FRAMES)
    assert Settings().part_s == 7.5
    assert json.loads(json.dumps(part_bounds(599, 30.0, part_s=10.0))) == [0, 599]
    assert part_bounds(600, 30.0, part_s=10.0) == (0, 300, 600)
    assert part_bounds(1, None, part_s=10.0) == (0, 1)
