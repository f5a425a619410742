"""Fixtures of the worker's tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from service.settings import Settings
from tests.service.fixtures import api, clock, database, make_tables, plain_logs, settings
from tests.worker.runners import runner_of
from worker.runner import Runner
from worker.sandbox import SandboxServer

__all__ = ["api", "clock", "database", "plain_logs", "settings"]


@pytest.fixture
def runner(settings: Settings) -> Runner:
    """A worker that cannot work on media."""
    make_tables(settings.database)
    return runner_of(settings)


@pytest.fixture(scope="session")
def warm_server() -> Iterator[SandboxServer]:
    """The fork server with the method in it."""
    server = SandboxServer("tests")
    server.start()
    yield server
    server.stop()
