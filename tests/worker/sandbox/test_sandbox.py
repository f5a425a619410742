"""What a job's process can and cannot do, tried from inside; and that the worker outlives whatever it does."""

from __future__ import annotations

import errno
import json
import os
import platform
import re
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from service.catalog import Database, Job, JobState, Media, utc_now
from service.settings import Settings
from service.storage import Storage
from tests.promises import Drill
from tests.service.fixtures import add_media, job_of, make_tables
from tests.service.servers import missing
from tests.waiting import until
from tests.worker.runners import runner_of
from worker.runner import Runner
from worker.sandbox import (
    Limits,
    MethodError,
    Sandbox,
    SandboxServer,
    UnforkedError,
    View,
    Watch,
    keeper,
    landlock,
    seccomp,
)
from worker.sandbox import server as fork_server
from worker.sandbox.client import answer_of

REPOSITORY = Path(__file__).resolve().parents[3]
LIMITS = Limits(memory_bytes=2**30, cpu_s=60, file_bytes=2**30)


@pytest.fixture(scope="module")
def server() -> Iterator[SandboxServer]:
    """A fork server whose jobs do what they like."""
    with pytest.MonkeyPatch.context() as path:
        path.setenv("PYTHONPATH", str(REPOSITORY))  # what it calls is a module of the tests
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("PVG_DATABASE_URL", "secret")
            patch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
            server = SandboxServer("tests", calls="tests.worker.sandbox.hostile")
            server.start()
        yield server
        server.stop()


@pytest.fixture
def attempts(server: SandboxServer, tmp_path: Path) -> dict[str, Any]:
    """What a process of this machine achieves that tries to leave its job."""
    absent = fork_server.missing()
    if absent:
        missing(f"THE SANDBOX IS NOT WHOLE ON THIS MACHINE, and its tests cannot run: {'; '.join(absent)}")
    for name in ("job", "other"):
        (tmp_path / name).mkdir()
    source, outside = tmp_path / "source", tmp_path / "other" / "face"
    source.write_text("the medium")
    outside.write_text("somebody else's face")
    with suppress(OSError):  # on file systems that keep no such notes the job fails at it anyway
        os.setxattr(source, "user.noted", b"x")
    arguments = {
        "source": str(source),
        "folder": str(tmp_path / "job"),
        "outside": str(outside),
        "supervisor": os.getpid(),
    }
    seen: list[str] = []
    watch = Watch(lambda: None, lambda stage, *_: seen.append(stage), time.monotonic() + 60)
    view = View((source,), tmp_path / "job")
    answer: dict[str, Any] = Sandbox(server.lobby).call("attempts", arguments, limits=LIMITS, view=view, watch=watch)
    assert seen == ["thread"]
    assert outside.read_text() == "somebody else's face"
    assert (tmp_path / "job" / "made").read_text() == "own"
    return answer


def test_a_job_sees_its_files_and_nothing_else(attempts: dict[str, Any]) -> None:
    assert attempts["done"] == []
    assert attempts["read"] == "the medium"
    assert attempts["descriptors"] <= 5  # the usual three to nowhere, its channel, and the listing itself
    assert attempts["capabilities"] == ["CapEff:\t0000000000000000"]
    assert attempts["networks"] == ["lo"]
    names = set(attempts["environment"])
    assert not {name for name in names if name.startswith("PVG_")} - {"PVG_CACHE_DIR"}
    assert "secret" not in str(attempts["environment"])


def test_what_a_machine_lacks_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(landlock, "version", lambda: 0)
    monkeypatch.setattr(platform, "machine", lambda: "s390x")
    lines = fork_server.missing()
    assert any("Landlock" in line for line in lines), lines
    assert any("s390x" in line for line in lines), lines


def test_to_ask_what_a_machine_lacks_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every start of a worker asks, and `/tmp` of its container has a bound."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    fork_server.missing()
    assert list(tmp_path.iterdir()) == []


#: which headers of before Linux 6.6, 6.8, 6.13, 6.15 and 6.17 lack: the same on all processors
NEW_CALLS = {
    **{"fchmodat2": 452, "statmount": 457, "listmount": 458, "setxattrat": 463, "removexattrat": 466},
    **{"open_tree_attr": 467, "file_setattr": 469},
}


@pytest.mark.parametrize(
    ("header", "column"),
    [("/usr/include/x86_64-linux-gnu/asm/unistd_64.h", 0), ("/usr/include/asm-generic/unistd.h", 1)],
)
def test_the_numbers_of_calls_are_the_kernels(header: str, column: int) -> None:
    if not Path(header).exists():
        missing(f"{header} is not installed")
    found = re.findall(r"#define __NR(?:3264)?_(\w+)\s+(\d+)", Path(header).read_text())
    theirs = NEW_CALLS | {name: int(number) for name, number in found}
    all_of_ours = {name: numbers[column] for name, numbers in (seccomp.REFUSED | seccomp.CHECKED).items()}
    ours = {name: number for name, number in all_of_ours.items() if number is not None}
    assert ours == {name: theirs.get(name) for name in ours}


@pytest.mark.parametrize(
    ("told", "limit"),
    [
        ([3.0, "seconds"], (3.0, "seconds")),
        ([3.0, "<b>"], None),
        ([-1, "frames"], None),
        ([float("nan"), "frames"], None),
        (["3", "frames"], None),
        ([3], None),
        (None, None),
    ],
)
def test_a_process_names_no_limit_of_its_own(told: object, limit: object) -> None:
    error = {"class": "TooLongError", "message": "x", "trace": "", "limit": told}
    with pytest.raises(MethodError) as caught:
        answer_of({"error": error}, LIMITS)
    assert caught.value.limit == limit


class ForklessLobby:
    """Behind it a fork server that cannot fork answers each request before its sender goes on."""

    def __init__(self, lobby: socket.socket, entrance: socket.socket) -> None:
        self._lobby = lobby
        self._server = fork_server._Server(entrance, SimpleNamespace(), ())  # type: ignore[arg-type]

    def sendmsg(self, *message: Any) -> int:
        sent = self._lobby.sendmsg(*message)
        assert self._server._admit()
        return sent


def test_a_job_that_could_not_be_forked_has_crashed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def fork() -> int:
        raise BlockingIOError(errno.EAGAIN, "not now")

    monkeypatch.setattr(os, "fork", fork)
    view, until_s = View((), tmp_path), time.monotonic() + 60
    watch = Watch(lambda: None, lambda *_: None, until_s)
    lobby, entrance = socket.socketpair()
    with lobby, entrance:
        sandbox = Sandbox(ForklessLobby(lobby, entrance))  # type: ignore[arg-type]
        with pytest.raises(UnforkedError, match="could not fork"):
            sandbox.call("x", {}, limits=LIMITS, view=view, watch=watch)
        with pytest.raises(UnforkedError, match="could not fork"):
            sandbox.open("x", {}, limits=LIMITS, view=view, until=until_s)


# jobs whose medium has taken over their process


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    return Settings(
        data_dir=tmp_path / "data",
        job_memory_bytes=3 * 2**29,
        job_file_bytes=2**22,
        progress_interval_s=0.1,
        heartbeat_s=1,
    )


@pytest.fixture
def database(settings: Settings) -> Iterator[Database]:
    make_tables(settings.database)
    database = Database(settings.database, clock=utc_now)
    yield database
    database.close()


@pytest.fixture
def runner(settings: Settings, server: SandboxServer, database: Database) -> Runner:
    return runner_of(settings, server.lobby)


def add(database: Database, settings: Settings, content: str | bytes) -> Media:
    """A medium that is to be vectorised, with its bytes."""
    data = content.encode() if isinstance(content, str) else content
    medium = add_media(database, content=data)
    storage = Storage(settings)
    draft = storage.spool.draft()
    draft.write_bytes(data)
    storage.put(draft, medium.source_key)
    return medium


def done(runner: Runner, database: Database, job_id: str) -> Job:
    runner.run(job_id)
    return job_of(database, job_id)


GOOD = {
    "media": {
        **{"kind": "video", "width": 64, "height": 64, "frame_rate": 25.0, "frame_count": 1, "duration_s": 0.04},
        **{"codec": "h264", "pixel_format": "yuv420p", "has_audio": False, "rotation": 0, "color": "SDR"},
        **{"color_primaries": 2, "color_transfer": 2, "warnings": []},
    },
    "faces": [],
    "pictures": [{"face": None, "start": 0, "end": 6}],
    "output": None,
}


@pytest.mark.parametrize(
    ("content", "problem", "detail"),
    [
        ("eat", "too-large", "1.6 GB"),
        ("write", "too-large", "file"),
        ("raise", "internal-error", "on our side"),
    ],
)
def test_a_limit_ends_the_job_with_its_problem_and_the_next_job_runs(
    runner: Runner, database: Database, settings: Settings, content: str, problem: str, detail: str
) -> None:
    job = done(runner, database, add(database, settings, content).job_id)
    assert (job.state, job.attempt) == (JobState.FAILED, 1)
    assert job.error is not None
    assert job.error["type"] == problem
    assert detail in job.error["detail"]
    assert "secret" not in str(job.error)
    assert done(runner, database, add(database, settings, f"answer {json.dumps(GOOD)}").job_id).state == "succeeded"
    assert list(settings.spool_folder.iterdir()) == []


@pytest.mark.parametrize("content", ["sleep", "spin"])
def test_the_time_limit_is_final_at_its_first_stroke(
    server: SandboxServer, database: Database, settings: Settings, content: str
) -> None:
    short = settings.model_copy(update={"job_soft_limit_s": 0.5})
    runner = runner_of(short, server.lobby)
    job = done(runner, database, add(database, settings, content).job_id)  # neither would end by itself
    assert (job.state, job.attempt) == (JobState.FAILED, 1)
    assert job.error is not None
    assert job.error["type"] == "time-limit"


INJECTED: dict[str, Any] = {
    "a look's answer": {"looks": []},
    "a number as text": GOOD | {"media": GOOD["media"] | {"width": "64"}},  # type: ignore[operator]
    "one field more": GOOD | {"asset_key": "source/x"},
    "a file that is not there": GOOD,
    "a picture beyond its file": GOOD | {"pictures": [{"face": 0, "start": 0, "end": 7}]},
}


@pytest.mark.parametrize("content", ["crash", "babble", *INJECTED])
def test_a_job_that_crashes_its_process_each_time_fails_after_three(
    runner: Runner, database: Database, settings: Settings, promise: Callable[..., Drill], content: str
) -> None:
    drill = promise("R6", wanted="failed `worker-crashed` after 3; the next job runs")
    if content in INJECTED:
        content = f"answer {json.dumps(INJECTED[content])}{'no file' if 'not there' in content else ''}"
    job_id = add(database, settings, content).job_id
    for attempt in (2, 3):
        job = done(runner, database, job_id)
        assert (job.state, job.attempt) == (JobState.QUEUED, attempt)
    job = done(runner, database, job_id)
    assert (job.state, job.attempt) == (JobState.FAILED, 3)
    assert job.error is not None
    assert job.error["type"] == "worker-crashed"
    following = done(runner, database, add(database, settings, f"answer {json.dumps(GOOD)}").job_id)
    drill.measured = f"attempt {job.attempt}: {job.error['type']}; the next one {following.state}"
    assert (following.state, following.attempt) == (JobState.SUCCEEDED, 1)


def test_text_of_a_process_is_one_line_of_bounded_length(
    runner: Runner, database: Database, settings: Settings
) -> None:
    text = "a\nb\x1b[31m" + "c" * 5000
    answer = GOOD | {"media": GOOD["media"] | {"warnings": [text]}}  # type: ignore[operator]
    medium = add(database, settings, f"answer {json.dumps(answer)}")
    assert done(runner, database, medium.job_id).state == JobState.SUCCEEDED
    with database.read() as session:
        kept = session.get(Media, medium.id)
    assert kept is not None
    (line,) = kept.warnings
    assert line.startswith("a b [31mccc")
    assert len(line) == 500


def test_a_fork_server_that_dies_is_replaced(
    server: SandboxServer, runner: Runner, database: Database, settings: Settings
) -> None:
    before = server.pid
    os.kill(before, 9)
    job = done(runner, database, add(database, settings, f"answer {json.dumps(GOOD)}").job_id)
    assert job.state == JobState.SUCCEEDED
    until(lambda: server.pid != before)  # the thread that looks after it is told at the same time


def test_a_fork_server_that_cannot_be_started_is_tried_again(
    server: SandboxServer, runner: Runner, database: Database, settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, failures = server.pid, [errno.EAGAIN, errno.ENOMEM]

    def popen(*arguments: Any, **options: Any) -> subprocess.Popen[bytes]:
        if failures:
            raise OSError(failures.pop(), "not now")
        return subprocess.Popen(*arguments, **options)

    monkeypatch.setattr(keeper, "subprocess", SimpleNamespace(Popen=popen, DEVNULL=subprocess.DEVNULL))
    os.kill(before, 9)
    until(lambda: server.pid != before, 60)
    assert failures == []
    job = done(runner, database, add(database, settings, f"answer {json.dumps(GOOD)}").job_id)
    assert job.state == JobState.SUCCEEDED


def test_a_server_that_is_stopped_as_its_process_begins_has_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever stopped it saw the process before this one, or none, and would wait for its end for ever."""
    server = SandboxServer("stopped", calls="tests.worker.sandbox.hostile")
    real, stopping, begun = subprocess.Popen, threading.Thread(target=server.stop), list[subprocess.Popen[bytes]]()

    def begins_late(*args: Any, **options: Any) -> subprocess.Popen[bytes]:
        stopping.start()
        until(server._stop.is_set)
        time.sleep(0.2)  # until it waits for the thread
        begun.append(real(*args, **options))
        return begun[0]

    monkeypatch.setattr(keeper.subprocess, "Popen", begins_late)
    server.lobby, server._entrance = socket.socketpair()
    server._thread.start()
    server._thread.join(30)
    try:
        assert not server._thread.is_alive()
        assert begun[0].poll() is not None
    finally:
        begun[0].kill()
        stopping.join(30)
