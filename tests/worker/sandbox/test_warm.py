"""The fork server with the method in it: what is ended at once, and what needs no loading."""

from __future__ import annotations

import os
import struct
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from service.catalog import Database, JobState, jobs, utc_now
from service.settings import Settings
from tests.promises import Drill
from tests.service.fixtures import job_of
from tests.waiting import until
from tests.worker.runners import runner_of
from tests.worker.sandbox.test_sandbox import add, database, done, settings
from worker.runner import Runner
from worker.sandbox import SandboxServer

__all__ = ["database", "settings"]


@pytest.fixture
def runner(settings: Settings, warm_server: SandboxServer, database: Database) -> Runner:
    return runner_of(settings, warm_server.lobby)


def jpeg_of_scans(count: int, blocks: int = 500) -> bytes:
    """A grey progressive picture of blocks² blocks whose every scan but the first says in some bytes that all blocks
    end: a decoder goes through all of them again for each (ITU-T T.81, G.1.2.2).
    """
    size = 8 * blocks
    frame = _segment(0xC2, struct.pack(">BHHB3B", 8, size, size, 1, 1, 0x11, 0))
    dc = _segment(0xC4, bytes([0x00, 1, *[0] * 15, 0]))  # one code, "0": the difference is 0
    ac = _segment(0xC4, bytes([0x10, 1, *[0] * 15, 0xE0]))  # one code, "0": the band ends for 2^14 + 14 bits blocks
    first = _segment(0xDA, bytes([1, 1, 0x00, 0, 0, 0])) + bytes(-(-blocks * blocks // 8))
    runs = -(-blocks * blocks // (2**15 - 1))
    bits = ("0" + "1" * 14) * runs
    ends = int(bits.ljust(-(-len(bits) // 8) * 8, "1"), 2).to_bytes(-(-len(bits) // 8), "big")
    scan = _segment(0xDA, bytes([1, 1, 0x00, 1, 63, 0])) + ends.replace(b"\xff", b"\xff\x00")
    tables = _segment(0xDB, bytes([0, *[1] * 64]))
    return b"\xff\xd8" + tables + frame + dc + ac + first + scan * count + b"\xff\xd9"


def _segment(marker: int, body: bytes) -> bytes:
    return bytes([0xFF, marker]) + struct.pack(">H", len(body) + 2) + body


def children(pid: int) -> list[str]:
    return Path(f"/proc/{pid}/task/{pid}/children").read_text().split()


def processor_s(pid: str) -> float:
    try:
        user, system = Path(f"/proc/{pid}/stat").read_text().rsplit(")")[1].split()[11:13]
    except OSError:
        return 0.0  # it has just ended
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def test_a_large_picture_that_is_decoded_is_canceled_within_two_seconds(
    warm_server: SandboxServer, runner: Runner, database: Database, settings: Settings, promise: Callable[..., Drill]
) -> None:
    drill = promise("R13", wanted="running stops within 2 s")
    medium = add(database, settings, jpeg_of_scans(99, blocks=700))  # the most scans that are let in
    work = threading.Thread(target=runner.run, args=(medium.job_id,))
    work.start()
    until(lambda: any(processor_s(child) > 0.3 for child in children(warm_server.pid)), 240)  # it decodes by then
    with database.write() as session:
        assert jobs.cancel(session, medium.job_id, now=utc_now())
    asked = time.monotonic()
    work.join(60)
    taken = time.monotonic() - asked
    drill.measured = f"decoding 31 MP in 100 scans: stopped after {taken:.2f} s"
    drill.keep_to(taken, 2, busy=20)
    assert children(warm_server.pid) == []
    job = job_of(database, medium.job_id)
    assert job.state == JobState.CANCELED


def test_a_picture_over_the_memory_of_a_job_is_refused_with_figures(
    warm_server: SandboxServer, database: Database, settings: Settings
) -> None:
    small = settings.model_copy(update={"job_memory_bytes": 1_200_000_000})
    runner = runner_of(small, warm_server.lobby)
    job = done(runner, database, add(database, settings, jpeg_of_scans(1, blocks=700)).job_id)
    assert job.error is not None
    assert job.error["type"] == "too-large"
    assert "5600x5600" in job.error["detail"]


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_server_that_cannot_be_kept_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    def serve(_: SandboxServer) -> None:
        raise MemoryError

    monkeypatch.setattr(SandboxServer, "_serve", serve)
    server, ended = SandboxServer("lost"), list[str]()

    def start() -> None:
        try:
            server.start()
        except RuntimeError as error:
            ended.append(str(error))

    starting = threading.Thread(target=start, daemon=True)
    starting.start()
    starting.join(30)
    assert "ends by itself" in "".join(ended)
