"""A disk or a shared folder that fails under a job's process: the job is tried again, and its file is not blamed."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import av.error
import numpy as np
import pytest

from pvg.errors import MediaError
from service import copying
from service import storage as storage_module
from service.catalog import Database, JobState
from service.settings import Settings
from service.storage import Storage
from tests.gallery.clips import encode_raw, libav_frame
from tests.worker.runners import runner_of
from tests.worker.sandbox.test_sandbox import add, database, done, server
from worker import runner as runner_module
from worker.runner import Runner
from worker.sandbox import Sandbox, SandboxServer
from worker.sandbox.faults import AWAY, fault_of

__all__ = ["database", "server"]


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    return Settings(data_dir=tmp_path / "my data", progress_interval_s=0.1, heartbeat_s=1)


@pytest.fixture
def runner(settings: Settings, server: SandboxServer, database: Database, monkeypatch: pytest.MonkeyPatch) -> Runner:
    monkeypatch.setattr(runner_module, "FAULT_PAUSE_S", 0.05, raising=False)
    return runner_of(settings, server.lobby)


def raised(*errors: BaseException) -> BaseException:
    """The last of these, each having led to the next."""
    for before, after in pairwise(errors):
        after.__context__ = before
    return errors[-1]


@pytest.mark.parametrize(
    ("error", "fault"),
    [
        (MediaError("x"), None),
        (ValueError("x"), None),
        (OSError(errno.EINVAL, "x"), None),
        (raised(av.error.InvalidDataError(1094995529, "x"), MediaError("x")), None),
        (OSError(errno.ESTALE, "x"), "certain"),
        (raised(OSError(errno.EIO, "x"), MediaError("x")), "certain"),
        (raised(av.error.OSError(errno.ESTALE, "x"), MediaError("x")), "certain"),
        (raised(av.error.OSError(errno.EIO, "x"), MediaError("x")), "possible"),
        (raised(OSError(errno.EIO, "x"), av.error.OSError(errno.EIO, "x"), MediaError("x")), "certain"),
        (raised(FileNotFoundError(errno.ENOENT, "x"), MediaError("x")), "possible"),
    ],
)
def test_a_fault_is_told_by_the_system_error_behind_it(error: BaseException, fault: str | None) -> None:
    assert fault_of(error) == fault


def test_what_the_storage_takes_for_away_is_a_fault() -> None:
    assert AWAY - {errno.EROFS} == storage_module._AWAY


@pytest.mark.parametrize("number", [errno.EIO, errno.ESTALE])
def test_a_job_whose_file_cannot_be_read_is_tried_again(
    runner: Runner, database: Database, settings: Settings, number: int
) -> None:
    medium = add(database, settings, f"fail system {number}")
    reached = []
    for _ in range(3):
        job = done(runner, database, medium.job_id)
        reached.append((job.state, job.attempt))
    assert reached == [(JobState.QUEUED, 2), (JobState.QUEUED, 3), (JobState.FAILED, 3)]
    assert job.error is not None
    assert job.error["type"] == "unavailable"
    assert str(settings.folder) not in str(job.error)


def test_what_libav_says_of_a_file_that_can_be_read_is_final(
    runner: Runner, database: Database, settings: Settings
) -> None:
    job = done(runner, database, add(database, settings, f"fail libav {errno.EIO}").job_id)
    assert (job.state, job.attempt) == (JobState.FAILED, 1)
    assert job.error is not None
    assert (job.error["type"], job.error["detail"]) == (
        "media-invalid",
        f"the file cannot be read: {os.strerror(errno.EIO)}",
    )


def test_a_file_that_does_not_answer_is_waited_for_and_not_blamed(
    runner: Runner, database: Database, settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    medium, tries = add(database, settings, f"fail libav {errno.EIO}"), list[Path]()
    read_through: Callable[[Path], None] = copying.read_through

    def fails_twice(path: Path) -> None:
        tries.append(path)
        if len(tries) < 3:
            raise OSError(errno.ESTALE, os.strerror(errno.ESTALE))
        read_through(path)

    monkeypatch.setattr(copying, "read_through", fails_twice)
    job = done(runner, database, medium.job_id)
    assert (job.state, job.attempt, len(tries)) == (JobState.QUEUED, 2, 3)


def test_a_file_that_goes_while_it_is_read_is_lost(
    runner: Runner, database: Database, settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    medium = add(database, settings, f"fail system {errno.ENOENT}")
    call = Sandbox.call

    def gone(self: Sandbox, *given: Any, **named: Any) -> Any:
        try:
            return call(self, *given, **named)
        finally:
            assert settings.local_storage_folder is not None
            (settings.local_storage_folder / medium.source_key).unlink()

    monkeypatch.setattr(Sandbox, "call", gone)
    job = done(runner, database, medium.job_id)
    assert (job.state, job.attempt) == (JobState.FAILED, 1)
    assert job.error is not None
    assert job.error["type"] == "source-lost"


def test_a_clip_that_ends_within_its_header_is_damaged_at_once(
    warm_server: SandboxServer, database: Database, settings: Settings, tmp_path: Path
) -> None:
    """libav says of it what it says of a disk that fails."""
    clip = encode_raw(tmp_path / "a.mkv", [libav_frame(np.zeros((64, 64, 3), np.uint8))] * 3, "ffv1")
    runner = runner_of(settings, warm_server.lobby)
    job = done(runner, database, add(database, settings, clip.read_bytes()[:200]).job_id)
    assert job.error is not None
    assert "input/output error" in job.error["detail"]
    assert (job.state, job.attempt, job.error["type"]) == (JobState.FAILED, 1, "media-invalid")


def test_a_file_is_read_to_its_end(settings: Settings) -> None:
    storage = Storage(settings)
    assert storage._folder is not None
    storage.read_through(Path(__file__))
    with pytest.raises(storage_module.BlobMissingError):
        storage.read_through(storage._folder / "none")
