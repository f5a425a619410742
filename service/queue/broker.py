"""The broker: what the producer in the API and the consumer in the worker must agree on."""

from __future__ import annotations

import json
import os
import time
import uuid
from pathlib import Path
from queue import Empty
from typing import Any, Final

from kombu.entity import Exchange, Queue
from kombu.transport import TRANSPORT_ALIASES, filesystem

from service.catalog import JobKind, jobs
from service.settings import Settings

TASK: Final = "worker.run_job"
VECTORIZE: Final = jobs.QUEUE_OF[JobKind.VECTORIZE]
RENDER: Final = jobs.QUEUE_OF[JobKind.TRANSFER]
QUEUES: Final = (VECTORIZE, RENDER)


class Channel(filesystem.Channel):
    """Messages as files, each appearing and taken by one rename.

    kombu's own channel writes the file in place and takes it by a move that may cross disks: a reader can see
    half a message, which ends the worker, and two readers can take the same one.
    """

    def _put(  # type: ignore[override]  # kombu's own classes disagree on the names
        self, queue: str, payload: object, **_: object
    ) -> None:
        folder = Path(self.data_folder_out)
        name = f"{time.time_ns():020d}_{uuid.uuid4().hex}.{queue}"
        draft = folder / f"{name}.draft"
        draft.write_bytes(json.dumps(payload).encode())
        draft.rename(folder / f"{name}.msg")

    def _get(self, queue: str, timeout: float | None = None) -> Any:
        folder = Path(self.data_folder_in)
        suffix = f".{queue}.msg"
        for name in sorted(name for name in os.listdir(folder) if name.endswith(suffix)):
            taken = folder / f"{name}.taken"
            try:
                (folder / name).rename(taken)
            except FileNotFoundError:
                continue  # another worker was faster
            payload = taken.read_bytes()
            taken.unlink()
            return json.loads(payload)
        raise Empty

    def _size(self, queue: str) -> int:
        return sum(name.endswith(f".{queue}.msg") for name in os.listdir(self.data_folder_in))


class Transport(filesystem.Transport):
    """kombu's filesystem transport with the channel above."""

    Channel = Channel


_FILES: Final = "pvgfiles"
TRANSPORT_ALIASES[_FILES] = f"{__name__}:Transport"


def uses_files(settings: Settings) -> bool:
    """True for the embedded broker, whose messages are files in the data folder."""
    return not settings.broker_url or settings.broker_url.startswith("filesystem://")


def _queue(name: str) -> Queue:
    return Queue(name, Exchange(""), routing_key=name, durable=True)  # type: ignore[no-untyped-call]


def celery_settings(settings: Settings) -> dict[str, Any]:
    """The Celery settings that producer and consumer share."""
    shared: dict[str, Any] = {
        "broker_url": f"{_FILES}://localhost" if uses_files(settings) else settings.broker_url,
        "broker_connection_retry_on_startup": True,
        "task_serializer": "json",
        "result_serializer": "json",
        "accept_content": ["json"],
        "task_ignore_result": True,
        "result_backend": None,
        # the nameless exchange needs no binding to be kept anywhere
        "task_queues": [_queue(name) for name in QUEUES],
        "task_create_missing_queues": False,
        "task_default_queue": RENDER,
        "task_default_exchange": "",
        "enable_utc": True,
        "worker_enable_remote_control": False,
    }
    if uses_files(settings):
        folder = settings.folder / "broker"
        shared["broker_transport_options"] = {
            "data_folder_in": str(folder / "messages"),
            "data_folder_out": str(folder / "messages"),
            "control_folder": str(folder / "control"),
            "polling_interval": settings.broker_polling_interval_s,
        }
    elif settings.broker_url.startswith(("redis", "rediss", "valkey", "sentinel")):
        shared["broker_transport_options"] = {
            # well above the longest job, or Redis hands a running job to a second worker
            "visibility_timeout": int(settings.job_hard_limit_s * 2) + 3600,
            "unacked_restore_throttle": 1,
            "socket_keepalive": True,
            "socket_connect_timeout": 2.0,
            "socket_timeout": 30.0,
            "health_check_interval": 25,
        }
    return shared


def make_folders(settings: Settings) -> None:
    """The folders of the embedded setting; nothing to do for what lives elsewhere."""
    settings.spool_folder.mkdir(parents=True, exist_ok=True)
    if uses_files(settings):
        for name in ("messages", "control"):
            (settings.folder / "broker" / name).mkdir(parents=True, exist_ok=True)
