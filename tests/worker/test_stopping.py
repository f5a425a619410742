"""Workers that are told to stop: what they were at goes on elsewhere, and they end soon."""

from __future__ import annotations

import json
import logging
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from billiard.exceptions import WorkerLostError

from scripts.samples import Samples
from service import health
from service.api.services import make_services
from service.catalog import Database, jobs
from service.processes import worker_command, worker_environment
from service.settings import Settings
from tests.gallery.clips import repeat_clip
from tests.promises import Drill
from tests.service.fixtures import MP4, make_ready, make_results, make_tables
from tests.service.servers import check_namespaces
from tests.waiting import until
from tests.worker.serving import (
    Service,
    kill_all,
    processes_of,
    running_service,
    wait_until_gone,
    worker_processes,
)
from worker import stopping

QUICK = {"heartbeat_s": "1", "progress_interval_s": "0.2", "worker_concurrency": "1"}
#: a worker is not ended (`worker.stopping.end_within`) because the machine stands still for some seconds; it gives back
#: only jobs that take longer than this
GRACE = {"worker_stop_grace_s": "30"}
#: runs a command as the first process of a container
FIRST = ("unshare", "--user", "--map-root-user", "--pid", "--fork", "--kill-child")


@pytest.fixture(scope="module")
def long_clip(samples: Samples, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A woman, 640x360, 24 times one after the other: 11,328 frames, more than the grace of work anywhere."""
    return repeat_clip(samples.woman_full, tmp_path_factory.mktemp("clips") / "long.mp4", 24)


@contextmanager
def worker(service: Service, **settings: str) -> Iterator[subprocess.Popen[bytes]]:
    """A worker alone, beside a service."""
    (environ,) = (
        (Path("/proc") / str(pid) / "environ").read_bytes()
        for pid, command in processes_of(service.data_dir).items()
        if pid == service.process.pid
    )
    environment = dict(line.split("=", 1) for line in os.fsdecode(environ).split("\0") if "=" in line)
    environment |= {f"PVG_{name.upper()}": value for name, value in settings.items()}
    command = [str(Path(sys.executable).with_name("pvg-service")), "worker"]
    with service.log.with_name("worker.log").open("ab") as output:
        process = subprocess.Popen(command, env=environment, stdout=output, stderr=output)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def until_it_is(service: Service, job_id: str, reached: Any, seconds: float) -> dict[str, Any]:
    """The job, once it is as wanted."""
    end = time.monotonic() + seconds
    while not reached(job := service.job(job_id)):
        assert time.monotonic() < end, (job, service.log.read_text()[-3000:])
        time.sleep(0.05)
    return job


def until_ready(service: Service, process: subprocess.Popen[bytes]) -> None:
    """Until a worker says that it takes messages, which it does some time after its first children are there."""
    log = service.log.with_name("worker.log")
    takes = re.compile(rf"-{process.pid}@\S+ ready\.")
    until(lambda: takes.search(log.read_text()), 180, said=log.read_text)


def begun(service: Service, job_id: str) -> dict[str, Any]:
    """The job, once it has been at work for long enough to be no short one."""
    job = until_it_is(service, job_id, lambda job: job["state"] == "running", 180)
    time.sleep(1.5)
    return job


def quick_on(broker: str, request: pytest.FixtureRequest) -> dict[str, str]:
    """Settings with the embedded broker ("files"), or with Redis."""
    return QUICK | ({"broker_url": request.getfixturevalue("redis_url")} if broker == "redis" else {})


@pytest.mark.parametrize("broker", [pytest.param("files", marks=pytest.mark.slow), "redis"])
def test_a_long_job_goes_on_elsewhere_and_no_deploy_costs_an_attempt(
    broker: str, tmp_path: Path, long_clip: Path, request: pytest.FixtureRequest, promise: Callable[..., Drill]
) -> None:
    drill = promise("R7", wanted="another goes on within 5 s, no attempt; exit 0 within 30 s")
    settings = quick_on(broker, request) | GRACE
    with running_service(tmp_path, arguments=["--no-worker"], **settings) as service, ExitStack() as stack:
        job_id = service.upload("/videos", long_clip)["job"]
        old = stack.enter_context(worker(service))
        before = begun(service, job_id)
        new = stack.enter_context(worker(service))
        until_ready(service, new)
        told = time.monotonic()
        old.send_signal(signal.SIGTERM)
        after = until_it_is(service, job_id, lambda job: job["started_at"] != before["started_at"], 60)
        taken_s = time.monotonic() - told
        assert old.wait(150) == 0
        ended_s = time.monotonic() - told
        drill.measured = f"{broker}: taken over after {taken_s:.1f} s, exit 0 after {ended_s:.1f} s"
        assert (after["attempt"], after["state"]) == (1, "running")
        drill.keep_to(taken_s, 5)
        drill.keep_to(ended_s, 30)
        # and when every process is told at once, as a service manager does
        begun(service, job_id)
        kill_all([pid for pid, command in service.processes().items() if "worker.app" in command], signal.SIGTERM)
        assert new.wait(150) == 0
        assert until_it_is(service, job_id, lambda job: job["state"] == "queued", 60)["attempt"] == 1
        assert "WorkerLostError" not in service.log.with_name("worker.log").read_text()


@pytest.mark.slow
@pytest.mark.parametrize("broker", ["files", "redis"])
def test_a_short_job_is_finished_by_a_worker_that_stops_and_a_long_one_by_another(
    broker: str, tmp_path: Path, samples: Samples, request: pytest.FixtureRequest, promise: Callable[..., Drill]
) -> None:
    drill = promise("R7", wanted="a short job is finished, a long one finishes elsewhere; exit 0 within 30 s")
    settings = quick_on(broker, request)
    with running_service(tmp_path, arguments=["--no-worker"], **settings) as service, ExitStack() as stack:
        old = stack.enter_context(worker(service, worker_concurrency="2"))
        picture = service.ready("/videos", samples.portrait)["id"]
        long = service.upload("/videos", samples.woman_clip)["job"]
        begun(service, long)
        wanted = {"video": picture, "looks": [{"reference": picture}]}
        short = service.client.post("/transfer", json=wanted).raise_for_status().json()["id"]
        until_it_is(service, short, lambda job: job["state"] == "running", 180)
        told, told_at = time.monotonic(), datetime.now(UTC)
        old.send_signal(signal.SIGTERM)
        assert old.wait(150) == 0
        ended_s = time.monotonic() - told
        states = [(job["state"], job["attempt"]) for job in (service.job(short), service.job(long))]
        new = stack.enter_context(worker(service))
        done = service.finished(long)
        log = service.log.with_name("worker.log").read_text()
        times = [_begun_times(log, job) for job in (short, long)]
        drill.measured = (
            f"{broker}: short {states[0][0]}, exit 0 after {ended_s:.1f} s; long {states[1][0]} by then, "
            f"{done['state']} by another on attempt {done['attempt']}"
        )
        assert states == [("succeeded", 1), ("queued", 1)]
        assert datetime.fromisoformat(service.job(short)["finished_at"]) > told_at
        assert (done["state"], done["attempt"]) == ("succeeded", 1)
        assert times == [1, 2]
        assert new.poll() is None
        drill.keep_to(ended_s, 30)


def _begun_times(log: str, job_id: str) -> int:
    """How often workers say that they began a job."""
    lines = [json.loads(line) for line in log.splitlines() if line.startswith("{")]
    return sum(line["event"] == "job begins" and line.get("job") == job_id for line in lines)


@pytest.mark.parametrize("asked_at", [None, 1.0])
def test_a_child_that_ends_is_an_error_unless_its_worker_was_told_to_stop(
    asked_at: float | None, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(stopping, "asked_at", lambda: asked_at)
    log = logging.getLogger("celery.worker.request")
    monkeypatch.setattr(log, "filters", [stopping.is_no_loss])
    with caplog.at_level(logging.INFO, "celery.worker.request"):
        for error in (WorkerLostError("signal 15"), ValueError("of a task")):
            log.error("Task handler raised error: %r", error, exc_info=(type(error), error, None))
    stopped = "INFO" if asked_at is not None else "ERROR"
    assert [record.levelname for record in caplog.records] == [stopped, "ERROR"]
    assert ("WorkerLostError" in caplog.text) == (asked_at is None)


#: a process that hangs, with a child that is tied to it and says when it is there
_HANGS = """
import os, sys, threading
from service.logs import configure
from worker import lifeline, stopping
configure("INFO")
if os.fork() == 0:
    lifeline.die_with_parent()
    print(flush=True)
    threading.Event().wait()
stopping.end_within(float(sys.argv[1]))
threading.Event().wait()
"""


@pytest.mark.parametrize("before", [(), FIRST], ids=["a-process", "the-first-of-a-container"])
def test_a_worker_that_hangs_ends_with_status_0(before: tuple[str, ...]) -> None:
    if before:
        check_namespaces(*before)
    command = [*before, sys.executable, "-c", _HANGS, "0.5"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            said, told = process.communicate(timeout=60)  # the child has the output open for as long as it lives
        except subprocess.TimeoutExpired:
            process.kill()
            raise
    assert (process.returncode, said) == (0, "\n"), told
    assert "does not end by itself" in told


@pytest.mark.slow
def test_a_worker_of_which_a_process_hangs_ends_in_time(tmp_path: Path, promise: Callable[..., Drill]) -> None:
    drill = promise("R7", wanted="a pool process that hangs: exit 0 within 30 s")
    settings = Settings(data_dir=tmp_path / "data", worker_concurrency=1)
    make_tables(settings.database)
    environment = worker_environment(settings) | {"PVG_WORKER_CONCURRENCY": "1"}
    with (tmp_path / "log").open("wb") as log:
        process = subprocess.Popen(worker_command(settings), env=environment, stdout=log, stderr=log)
    try:
        until(lambda: health.of_workers(settings, "jobs")[0], 180, said=(tmp_path / "log").read_text)
        kill_all(worker_processes(settings.folder, 2) - {process.pid}, signal.SIGSTOP)
        told = time.monotonic()
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0
        ended_s = time.monotonic() - told
        assert wait_until_gone(settings.folder, 30) == {}
    finally:
        process.kill()
        process.wait()
    drill.measured = f"exit 0 after {ended_s:.1f} s"
    drill.keep_to(ended_s, 30)


def being_answered(service: Service) -> int:
    """How many requests the service has read and not answered yet, with that of this question."""
    figures = service.client.get("/metrics").raise_for_status().text
    (line,) = [line for line in figures.splitlines() if line.startswith("pvg_http_requests_in_progress ")]
    return int(float(line.split()[1]))


def slowly(told: threading.Event, pieces: int, content: bytes) -> Iterator[bytes]:
    """A body of which the first piece goes out at once, and the others from when the service was told to stop."""
    size = len(content) // pieces
    for number in range(pieces):
        if number == 1:
            told.wait(60)
            began = time.monotonic()
        yield content[number * size : None if number == pieces - 1 else (number + 1) * size]
        if number:
            sleep_until(began + 0.3 * number)


def sleep_until(at: float) -> None:
    """Wait until this second of the steady clock: what goes on step by step has its own pace on a busy machine, too."""
    time.sleep(max(0.0, at - time.monotonic()))


def test_an_upload_and_a_download_in_flight_are_finished_by_a_service_that_stops(
    tmp_path: Path, promise: Callable[..., Drill]
) -> None:
    drill = promise("R8", wanted="not ready first; both finish within 20 s")
    content, made = MP4 + os.urandom(2**20), os.urandom(48 * 2**20)
    # the notice is long enough to ask /readyz meanwhile, on a busy machine too; both take longer than the notice
    with running_service(tmp_path, arguments=["--no-worker"], stop_notice_s="10", **QUICK) as service:
        video = service.client.post("/videos", content=MP4).json()
        services = make_services(Settings(data_dir=service.data_dir))
        make_ready(services, video["id"])
        looks = [{"reference": video["id"]}]
        job = service.client.post("/transfer", json={"video": video["id"], "looks": looks}).json()
        (result,) = make_results(services, job["id"], [made])
        services.close()
        told = threading.Event()
        with ThreadPoolExecutor() as clients, service.client.stream("GET", f"/results/{result}") as download:
            pieces = download.iter_bytes(2**16)
            received = bytearray(next(pieces))  # the rest is more than the kernel keeps on its way
            upload = clients.submit(service.client.post, "/videos", content=slowly(told, 40, content))
            until(service.drafts)
            at = time.monotonic()
            service.process.send_signal(signal.SIGTERM)
            while (ready := service.client.get("/readyz")).status_code == 200:
                assert time.monotonic() < at + 20
            assert ready.json()["status"] == "stopping"
            unready_s = time.monotonic() - at
            assert not upload.done()
            told.set()
            for number, piece in enumerate(pieces):
                received += piece
                sleep_until(at + 0.015 * number)
            downloaded_s = time.monotonic() - at
            answer = upload.result(90)
            uploaded_s = time.monotonic() - at
        assert service.process.wait(90) in {0, -signal.SIGTERM}
        drill.measured = (
            f"not ready after {unready_s:.1f} s, {len(received) >> 20} MiB read after {downloaded_s:.1f} s, upload "
            f"{answer.status_code} after {uploaded_s:.1f} s, gone after {time.monotonic() - at:.1f} s"
        )
        drill.keep_to(max(downloaded_s, uploaded_s), 20)
        assert (answer.status_code, download.status_code) == (202, 200)
        assert bytes(received) == made
        assert answer.json()["state"] == "vectorizing"


def test_a_service_that_stops_is_not_ready_first_and_gone_within_twenty_seconds(
    tmp_path: Path, long_clip: Path, promise: Callable[..., Drill]
) -> None:
    drill = promise("R8", wanted="not ready first, gone within 20 s")
    with running_service(tmp_path, stop_notice_s="10", **QUICK, **GRACE) as service:
        job_id = service.upload("/videos", long_clip)["job"]
        begun(service, job_id)
        with ThreadPoolExecutor() as clients:
            waiting = clients.submit(service.client.get, f"/jobs/{job_id}?wait=60")
            until(lambda: being_answered(service) == 2)  # the long poll, and what asks for this
            told = time.monotonic()
            service.process.send_signal(signal.SIGTERM)
            while (ready := service.client.get("/readyz")).status_code == 200:
                assert time.monotonic() < told + 20
            assert ready.json()["status"] == "stopping"
            assert waiting.result(50).json()["state"] in {"running", "queued"}
            answered_s = time.monotonic() - told
        assert service.process.wait(120) in {0, -signal.SIGTERM}
        gone_s = time.monotonic() - told
        drill.measured = f"long poll ended after {answered_s:.1f} s, all gone after {gone_s:.1f} s"
        drill.keep_to(answered_s, 3, busy=10)
        drill.keep_to(gone_s, 20)
        assert wait_until_gone(service.data_dir, 30) == {}
    database = Database(Settings(data_dir=service.data_dir).database)
    with database.read() as session:
        job = jobs.get(session, job_id)
    database.close()
    assert job is not None
    assert (job.state, job.attempt) == ("queued", 1)


#: a process whose names are looked up by a server that does not answer
_HANGING_NAMES = """
import pathlib, socket, time
_known = socket.getaddrinfo
def getaddrinfo(host, *args, flags=0, **kwargs):
    if host == "hangs.example" and not flags & socket.AI_NUMERICHOST:
        pathlib.Path(__file__).with_name("asked").touch()
        time.sleep(300)
    return _known(host, *args, flags=flags, **kwargs)
socket.getaddrinfo = getaddrinfo
"""


def test_a_name_server_that_hangs_does_not_hold_up_a_stop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, promise: Callable[..., Drill]
) -> None:
    drill = promise("R8", wanted="with a name server that hangs: gone within 20 s")
    (tmp_path / "sitecustomize.py").write_text(_HANGING_NAMES)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, (str(tmp_path), os.environ.get("PYTHONPATH")))))
    with running_service(tmp_path, arguments=["--no-worker"], **QUICK) as service:
        asked = {"url": "http://hangs.example/clip.mp4"}
        with ThreadPoolExecutor() as clients:
            fetched = [clients.submit(service.client.post, "/videos", json=asked) for _ in range(10)]
            until((tmp_path / "asked").exists, said=lambda: service.log.read_text()[-3000:])
            told = time.monotonic()
            service.process.send_signal(signal.SIGTERM)
            assert service.process.wait(120) in {0, -signal.SIGTERM}
            gone_s = time.monotonic() - told
            # cut off, or answered that it stops
            assert not any(one.exception() is None and one.result().is_success for one in fetched)
        drill.measured = f"gone after {gone_s:.1f} s"
        drill.keep_to(gone_s, 20)
