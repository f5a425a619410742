"""The real service, started by its command: API, worker and broker, on the embedded and on the scaled setting."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import pvg
from pvg.video import probe, read_frames
from scripts.samples import Samples
from tests.conftest import cut_clip
from tests.service.servers import free_port, fresh_database, redis_server
from tests.worker.serving import Service, processes_of, running_service, wait_until_gone

QUICK = {"lease_s": "8", "heartbeat_s": "1", "reap_interval_s": "1", "progress_interval_s": "0.2"}


@pytest.fixture(scope="module", params=["embedded", "scaled"])
def service(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """Embedded: SQLite and a broker of files. Scaled: PostgreSQL and Redis."""
    folder = tmp_path_factory.mktemp(request.param)
    if request.param == "embedded":
        with running_service(folder, **QUICK) as running:
            yield running
        return
    broker = request.getfixturevalue("redis_url")
    with (
        fresh_database(request.getfixturevalue("postgres_url")) as database,
        running_service(folder, broker_url=broker, database_url=database, **QUICK) as running,
    ):
        yield running


@pytest.fixture(scope="module")
def clip(samples: Samples, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """24 frames of a woman, 640x360."""
    return cut_clip(samples.woman_clip, tmp_path_factory.mktemp("clip") / "woman.mp4", 20, 44)


def frames(path: Path) -> NDArray[np.uint8]:
    return np.stack([frame.rgb() for frame in read_frames(path)])


def download(service: Service, result_id: str, target: Path) -> Path:
    answer = service.client.get(f"/results/{result_id}").raise_for_status()
    assert hashlib.sha256(answer.content).hexdigest() == answer.headers["etag"].strip('"')
    target.write_bytes(answer.content)
    return target


def jobs_begun(service: Service, kind: str) -> int:
    """How many jobs of a kind the worker has begun, by its own log."""
    lines = [json.loads(line) for line in service.log.read_text().splitlines() if line.startswith("{")]
    return sum(line["event"] == "job begins" and line["kind"] == kind for line in lines)


def test_a_clip_is_recoloured_from_two_portraits(
    service: Service, clip: Path, samples: Samples, tmp_path: Path
) -> None:
    video = service.upload("/videos", clip)
    assert video["state"] == "vectorizing"
    # sent while everything still vectorises: it waits by itself
    references = [service.upload("/references", file) for file in (samples.dark_portrait, samples.pale_portrait)]
    looks = [{"reference": reference["id"]} for reference in references]
    job = service.client.post("/transfer", json={"video": video["id"], "looks": looks}).json()
    done = service.finished(job["id"])
    assert done["state"] == "succeeded", done
    assert (done["progress"]["fraction"], done["attempt"], done["error"]) == (1.0, 1, None)
    assert {"queued_s", "transfer_s", "render_s", "store_s"} <= done["timings"].keys()

    ready = service.client.get(f"/videos/{video['id']}").json()
    assert ready["state"] == "ready"
    assert (ready["media"]["width"], ready["media"]["height"], ready["media"]["frame_count"]) == (640, 360, 24)
    assert len(ready["faces"]) == 1

    source = frames(clip)
    drawn = [download(service, look["result"], tmp_path / f"{i}.mp4") for i, look in enumerate(done["looks"])]
    first, second = (frames(path) for path in drawn)
    assert first.shape == second.shape == source.shape
    assert probe(drawn[0]).has_audio == probe(clip).has_audio
    changed = np.abs(first.astype(int) - source).max(axis=(0, 3)) > 16
    assert 0.01 < changed.mean() < 0.5
    # the two results differ the way their references do
    skins = [
        np.array(service.client.get(f"/references/{one['id']}").json()["faces"][0]["skin_rgb"]) for one in references
    ]
    assert ((first[:, changed].mean(axis=(0, 1)) > second[:, changed].mean(axis=(0, 1))) == (skins[0] > skins[1])).all()

    # the same bytes again: the same video, and another transfer vectorises nothing
    before = jobs_begun(service, "vectorize")
    again = service.upload("/videos", clip)
    assert (again["id"], again["state"]) == (video["id"], "ready")
    with samples.dark_portrait.open("rb") as portrait:
        form = service.client.post(
            "/transfer", data={"video": video["id"], "strength": "0"}, files={"reference": ("me.jpg", portrait)}
        )
    unchanged = service.finished(form.json()["id"])
    assert unchanged["state"] == "succeeded", unchanged
    assert unchanged["looks"][0]["reference"] == references[0]["id"]
    same = frames(download(service, unchanged["looks"][0]["result"], tmp_path / "same.mp4"))
    assert np.abs(same.astype(int) - source).mean() < 3
    assert jobs_begun(service, "vectorize") == before == 3
    assert jobs_begun(service, "transfer") == 2


def test_a_swap_recolours_both(service: Service, clip: Path, samples: Samples, tmp_path: Path) -> None:
    woman, man = service.ready("/videos", clip), service.ready("/videos", samples.dark_portrait)
    job = service.client.post("/swap", json={"a": woman["id"], "b": man["id"]}).json()
    done = service.finished(job["id"])
    assert done["state"] == "succeeded", done
    first, second = done["looks"]
    assert (first["video"], second["video"]) == (woman["id"], man["id"])
    assert len(frames(download(service, first["result"], tmp_path / "a.mp4"))) == 24
    picture = service.client.get(f"/results/{second['result']}")
    assert picture.headers["content-type"] == "image/png"
    drawn = cv2.imdecode(np.frombuffer(picture.content, np.uint8), cv2.IMREAD_COLOR)
    source = cv2.imread(str(samples.dark_portrait))
    assert drawn is not None
    assert source is not None
    assert drawn.shape == source.shape
    assert np.abs(drawn.astype(int) - source).max() > 30


def test_a_group_picture_is_a_reference_of_many_faces_and_a_clip_of_two_that_swap(
    service: Service, clip: Path, samples: Samples, tmp_path: Path
) -> None:
    picture = {"video": service.upload("/videos", samples.portrait)["id"]}
    upload = service.upload("/references", samples.several_faces)
    # asked for while nobody knows how many faces there are
    early = service.client.post(
        "/transfer", json=picture | {"looks": [{"reference": upload["id"], "reference_face": 9}]}
    )
    group = service.ready("/references", samples.several_faces)
    assert [face["index"] for face in group["faces"]] == [0, 1, 2, 3, 4]
    assert all("200 px or more is advised" in face["warnings"][0] for face in group["faces"])
    assert [warning[:8] for warning in group["warnings"]] == [f"face {i}: " for i in range(5)]
    late = service.client.post("/transfer", json=picture | {"looks": [{"reference": group["id"], "reference_face": 9}]})
    assert (late.status_code, late.json()["errors"][0]["pointer"]) == (422, "/looks/0/reference_face")
    failed = service.finished(early.json()["id"])
    assert (failed["state"], failed["error"]["type"]) == ("failed", "validation-failed")
    assert failed["error"]["detail"] == "no face 9; this reference has faces 0 to 4"

    paper = {"match": "color", "contrast": 1.0, "beta": 0.3, "iterations": 10, "seed": 5}
    asked = [{"reference": group["id"], "reference_face": face} | paper for face in (0, 1)]
    looks = service.client.post("/transfer", json=picture | {"looks": asked}).json()
    done = service.finished(looks["id"])
    assert done["state"] == "succeeded", done
    for i, look in enumerate(done["looks"]):
        assert look["settings"] == {"mask": "landmarks", "matching": "table"}
        assert asked[i].items() <= (look["options"] | {"reference": group["id"]}).items()
        assert look["warnings"][-1].startswith(f"reference, face {i}: the face is ")
    first, second = (service.client.get(look["url"]).content for look in done["looks"])
    assert first != second

    video = service.ready("/videos", samples.several_faces)
    swap = {"a": video["id"], "faces": [1, 4], "contrast": [0.8, 1.2]}
    swapped = service.finished(service.client.post("/swap", json=swap).json()["id"])
    assert swapped["state"] == "succeeded", swapped
    (look,) = swapped["looks"]
    drawn = frames(download(service, look["result"], tmp_path / "swapped.png"))
    assert [warning[:13] for warning in look["warnings"]] == ["video, face 1", "video, face 4"]
    with pvg.vectorize(samples.several_faces) as own:
        expected = pvg.render_frame(own, pvg.exchange(own, (1, 4), contrast=(0.8, 1.2)), 0)
    np.testing.assert_array_equal(drawn[0], expected)


def test_a_clip_is_vectorised_in_the_papers_way_beside_ours(service: Service, clip: Path) -> None:
    ours = service.ready("/videos", clip)
    with clip.open("rb") as data:
        form = service.client.post(
            "/videos", data={"mask": "ycbcr", "matching": "chain"}, files={"file": ("clip.mp4", data)}
        )
    papers = form.json()
    assert papers["id"] != ours["id"]
    assert service.finished(papers["job"])["state"] == "succeeded"
    look = {"reference": ours["id"], "match": "color", "contrast": 1.0}
    job = service.client.post("/transfer", json={"video": papers["id"], "looks": [look]}).json()
    done = service.finished(job["id"])
    assert done["state"] == "succeeded", done
    assert done["looks"][0]["settings"] == {"mask": "ycbcr", "matching": "chain"}


def test_what_has_no_face_fails_with_that_problem_and_so_do_the_jobs_that_wait_for_it(
    service: Service, clip: Path, samples: Samples
) -> None:
    video = service.ready("/videos", clip)
    faceless = cut_clip(samples.no_face_clip, service.data_dir.parent / "nobody.mp4", 0, 10)
    reference = service.upload("/references", faceless)
    look = {"reference": reference["id"]}
    answer = service.client.post("/transfer", json={"video": video["id"], "looks": [look]})
    if answer.status_code == 202:
        job = service.finished(answer.json()["id"])
        assert (job["state"], job["error"]["type"]) == ("failed", "no-face")
    else:  # the vectorisation was faster than the request
        assert (answer.status_code, answer.json()["type"]) == (422, "no-face")
    service.finished(reference["job"])
    failed = service.client.get(f"/references/{reference['id']}").json()
    assert (failed["state"], failed["error"]["type"]) == ("failed", "no-face")
    assert "nobody.mp4" in failed["error"]["detail"]
    assert "source" not in failed["error"]["detail"]


def test_a_broken_file_fails_as_invalid_media(service: Service, clip: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken.mp4"
    broken.write_bytes(clip.read_bytes()[:2000])
    medium = service.upload("/videos", broken)
    job = service.finished(medium["job"])
    assert (job["state"], job["error"]["type"]) == ("failed", "media-invalid")
    assert "broken.mp4" in job["error"]["detail"]


def test_a_running_job_is_canceled_within_seconds(service: Service, samples: Samples) -> None:
    medium = service.upload("/videos", samples.woman_full)
    until = time.monotonic() + 30
    while (job := service.client.get(f"/jobs/{medium['job']}").json())["progress"]["frames_done"] < 1:
        assert time.monotonic() < until, job
        time.sleep(0.1)
    assert 0 < job["progress"]["fraction"] < 1
    assert service.client.post(f"/jobs/{medium['job']}/cancel").status_code == 202
    began = time.monotonic()
    assert service.finished(medium["job"])["state"] == "canceled"
    assert time.monotonic() - began < 5
    assert service.client.delete(f"/videos/{medium['id']}").status_code == 204


def busiest(service: Service) -> int:
    """The worker's process that uses the processor right now: the pool child at work."""
    workers = worker_processes(service.data_dir)
    before = {pid: processor_time(pid) for pid in workers}
    time.sleep(0.4)
    return max(workers, key=lambda pid: processor_time(pid) - before[pid])


def processor_time(pid: int) -> int:
    return sum(map(int, Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]))


def worker_processes(data_dir: Path, at_least: int = 1) -> set[int]:
    """The worker's main process and its pool children, once there are so many."""
    until = time.monotonic() + 20
    while True:
        found = {pid for pid, command in processes_of(data_dir).items() if "worker.app" in command}
        if len(found) >= at_least:
            return found
        assert time.monotonic() < until, found
        time.sleep(0.05)


def test_a_job_whose_process_is_killed_succeeds_on_its_second_attempt(service: Service, samples: Samples) -> None:
    medium = service.upload("/videos", samples.woman_clip)
    until = time.monotonic() + 30
    while service.client.get(f"/jobs/{medium['job']}").json()["progress"]["frames_done"] < 1:
        assert time.monotonic() < until
        time.sleep(0.05)
    os.kill(busiest(service), signal.SIGKILL)
    job = service.finished(medium["job"], 180)
    assert (job["state"], job["attempt"]) == ("succeeded", 2)
    until = time.monotonic() + 15
    while left := list((service.data_dir / "spool").iterdir()):
        assert time.monotonic() < until, left
        time.sleep(0.05)
    assert service.client.delete(f"/videos/{medium['id']}").status_code == 204


def test_a_busy_worker_outlives_its_broker(tmp_path: Path, samples: Samples) -> None:
    """Its only slot is taken while Redis goes away, so that nothing but the acknowledgement can tell it."""
    port = free_port()
    with ExitStack() as stack:
        broker = ExitStack()
        url = broker.enter_context(redis_server(tmp_path, port))
        settings = QUICK | {"broker_url": url, "worker_concurrency": "1", "republish_after_s": "1"}
        service = stack.enter_context(running_service(tmp_path, **settings))
        first = service.upload("/videos", samples.woman_clip)
        until = time.monotonic() + 60
        while service.client.get(f"/jobs/{first['job']}").json()["progress"]["frames_done"] < 1:
            assert time.monotonic() < until
            time.sleep(0.05)
        broker.close()
        second = service.upload("/references", samples.portrait)  # taken while the broker is away
        job = service.finished(first["job"], 120)
        assert (job["state"], job["attempt"]) == ("succeeded", 1)
        assert service.client.get(f"/jobs/{second['job']}").json()["state"] == "queued"
        time.sleep(3)  # the acknowledgement fails
        stack.enter_context(redis_server(tmp_path, port))
        assert service.finished(second["job"], 90)["state"] == "succeeded"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_stopping_leaves_no_process(tmp_path: Path, clip: Path, number: signal.Signals) -> None:
    with running_service(tmp_path, worker_stop_grace_s="1") as service:
        worker_processes(service.data_dir, 3)
        job = service.upload("/videos", clip)["job"]
        while service.client.get(f"/jobs/{job}").json()["state"] == "queued":
            time.sleep(0.05)
        service.process.send_signal(number)
        service.process.wait(40)
        assert service.process.returncode in {0, 130}
        assert service.processes() == {}


def test_a_killed_api_takes_its_worker_along(tmp_path: Path) -> None:
    with running_service(tmp_path) as service:
        worker_processes(service.data_dir, 3)
        service.process.kill()
        service.process.wait()
        assert wait_until_gone(service.data_dir, 5) == {}


def test_a_killed_worker_is_started_again(tmp_path: Path) -> None:
    with running_service(tmp_path, worker_restart_delay_s="0.1") as service:
        before = worker_processes(service.data_dir, 3)
        os.kill(min(before), signal.SIGKILL)
        until = time.monotonic() + 20
        while not (now := worker_processes(service.data_dir)) or now & before:
            assert time.monotonic() < until
            time.sleep(0.05)
        assert not now & before


def test_packages_in_the_folder_it_is_started_in_are_left_alone(tmp_path: Path, samples: Samples) -> None:
    for name in ("worker", "service", "pvg", "celery"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise SystemExit('imported from the current folder')")
    with running_service(tmp_path, cwd=tmp_path) as service:
        workers = worker_processes(service.data_dir, 3)
        assert service.ready("/references", samples.portrait)["state"] == "ready"
        assert workers <= worker_processes(service.data_dir, 3)
        assert "the worker ended by itself" not in service.log.read_text()
