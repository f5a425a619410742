"""Fixtures of the worker's tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.service.fixtures import api, clock, database, plain_logs, settings
from worker.sandbox import SandboxServer

__all__ = ["api", "clock", "database", "plain_logs", "settings"]


@pytest.fixture(scope="session")
def warm_server() -> Iterator[SandboxServer]:
    """The fork server with the method in it."""
    server = SandboxServer("tests")
    server.start()
    yield server
    server.stop()
