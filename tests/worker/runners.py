"""Runners of jobs, without the queue that they take them from."""

from __future__ import annotations

from socket import socket
from typing import Any, cast

from service.queue import TASK
from service.settings import Settings
from worker.runner import Runner
from worker.sandbox import Sandbox


class NoBroker:
    """What a runner publishes with; the tests look at the records."""

    def send_task(self, name: str, *_: object, **__: object) -> None:
        assert name == TASK


def runner_of(settings: Settings, lobby: socket | None = None) -> Runner:
    """One that works on media in the processes of a fork server, or on none: it has no process to do it in."""
    return Runner(settings, cast(Any, NoBroker()), Sandbox(cast(Any, lobby)))
