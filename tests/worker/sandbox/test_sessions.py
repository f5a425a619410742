"""Processes that stay: asked again and again, confined as all are, and gone when they should be."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.worker.sandbox.test_sandbox import LIMITS, server
from worker.sandbox import CrashError, MethodError, Sandbox, SandboxServer, Session, TimeLimitError, View

__all__ = ["server"]


def soon() -> float:
    return time.monotonic() + 60


@pytest.fixture
def session(server: SandboxServer, tmp_path: Path) -> Iterator[Session]:
    (tmp_path / "job").mkdir()
    source = tmp_path / "source"
    source.write_text("the medium")
    arguments = {"source": str(source)}
    view = View((source,), tmp_path / "job")
    opened = Sandbox(server.lobby).open("stay", arguments, limits=LIMITS, view=view, until=soon())
    yield opened
    opened.close()


def exists(pid: int) -> bool:
    return Path(f"/proc/{pid}").exists()


def test_one_process_answers_every_question(session: Session) -> None:
    first, second = session.ask({}, soon()), session.ask({}, soon())
    assert first == second
    assert first["kept"] == "the medium"
    assert first["pid"] != os.getpid()


def test_it_sees_nothing_else_and_goes_on_after_an_error(session: Session, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.write_text("somebody else's face")
    before = session.ask({}, soon())["pid"]
    with pytest.raises(MethodError, match="Permission denied") as caught:
        session.ask({"read": str(other)}, soon())
    assert caught.value.kind == "PermissionError"
    assert session.ask({}, soon())["pid"] == before


def test_a_crash_is_told_and_so_is_asking_afterwards(session: Session) -> None:
    for _ in range(2):
        with pytest.raises(CrashError):
            session.ask({"what": "crash"}, soon())


def test_one_that_takes_too_long_is_left_and_ended(session: Session) -> None:
    pid = session.ask({}, soon())["pid"]
    with pytest.raises(TimeLimitError):
        session.ask({"what": "hang"}, time.monotonic() + 0.3)
    session.close()
    assert not exists(pid)


def test_closing_ends_the_process(session: Session) -> None:
    pid = session.ask({}, soon())["pid"]
    assert exists(pid)
    session.close()
    assert not exists(pid)


def test_what_cannot_be_opened_leaves_no_process(server: SandboxServer, tmp_path: Path) -> None:
    (tmp_path / "job").mkdir()
    view = View((), tmp_path / "job")
    with pytest.raises(MethodError):
        Sandbox(server.lobby).open("stay", {"source": str(tmp_path / "absent")}, limits=LIMITS, view=view, until=soon())
    children = Path(f"/proc/{server.pid}/task/{server.pid}/children").read_text().split()
    assert children == []
