"""The broker: what the producer in the API and the consumer in the worker must agree on."""

from __future__ import annotations

import json
import math
import os
import time
import uuid
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from queue import Empty
from typing import Any, Final

import structlog
from kombu.entity import Exchange, Queue
from kombu.transport import TRANSPORT_ALIASES, filesystem

from service.catalog import JobKind, Message
from service.catalog.messages import QUEUE_OF
from service.folders import keep_to_ourselves, private_folder
from service.settings import Settings

log = structlog.get_logger(__name__)

TASK: Final = "worker.run_job"
PREVIEW_TASK: Final = "worker.make_preview"
#: the header of a message that names its job
JOB_HEADER: Final = "job"
#: seconds for which one listing of the folder of messages serves
LISTED_S: Final = 1.0
#: seconds after which a message that is being written or read is no longer: either takes milliseconds
_REMAINS_S: Final = 60.0
VECTORIZE: Final = QUEUE_OF[JobKind.VECTORIZE]
RENDER: Final = QUEUE_OF[JobKind.TRANSFER]
#: of jobs; a message that is lost is sent again
QUEUES: Final = (VECTORIZE, RENDER)
#: of single pictures that somebody waits for; one that is lost stays lost
PREVIEW: Final = "preview"


class Channel(filesystem.Channel):
    """Messages as files, each appearing and taken by one rename.

    kombu's own channel writes the file in place and takes it by a move that may cross disks: a reader can see
    half a message, which ends the worker, and two readers can take the same one. It also lists and sorts the folder
    for every message that it takes.

    A message is named after its job, whose id begins with the time it was made: the oldest job goes first, a message
    sent twice is one file, and that of a job which needs no worker any more is found without a look at the others.
    """

    def _put(  # type: ignore[override]  # kombu's own classes disagree on the names
        self, queue: str, payload: dict[str, Any], **_: object
    ) -> None:
        folder = Path(self.data_folder_out)
        draft = folder / f"{uuid.uuid4().hex}.draft"
        draft.write_bytes(json.dumps(payload).encode())
        draft.rename(_message_file(folder, payload["headers"][JOB_HEADER], queue))

    def _get(self, queue: str, timeout: float | None = None) -> Any:
        folder = Path(self.data_folder_in)
        for name in self._next_of(queue):
            taken = folder / f"{name}.{uuid.uuid4().hex}.taken"
            try:
                (folder / name).rename(taken)
            except FileNotFoundError:
                continue  # another worker was faster, or it was withdrawn
            payload = taken.read_bytes()
            taken.unlink()
            try:
                return json.loads(payload)
            except ValueError:  # a power cut may leave the name without the content; the reaper sends it again
                log.warning("a message is damaged and passed over", file=name, bytes=len(payload))
        raise Empty

    def _next_of(self, queue: str) -> Iterator[str]:
        """The messages of a queue, oldest first, each once: from a list that is at most `LISTED_S` old."""
        # when the folder was listed, and the messages seen then, the last one first
        listed: dict[str, tuple[float, list[str]]] = self.__dict__.setdefault("_listed", {})
        seen_at, names = listed.get(queue, (-math.inf, []))
        if not names or time.monotonic() - seen_at > LISTED_S:
            suffix = f".{queue}.msg"
            names = sorted((name for name in os.listdir(self.data_folder_in) if name.endswith(suffix)), reverse=True)
            listed[queue] = (time.monotonic(), names)
        while names:
            yield names.pop()

    def _size(self, queue: str) -> int:
        return sum(name.endswith(f".{queue}.msg") for name in os.listdir(self.data_folder_in))


def _message_file(folder: Path, job_id: str, queue: str) -> Path:
    return folder / f"{job_id}.{queue}.msg"


class Transport(filesystem.Transport):
    """kombu's filesystem transport with the channel above."""

    Channel = Channel


_FILES: Final = "pvgfiles"
TRANSPORT_ALIASES[_FILES] = f"{__name__}:Transport"


def _queue(name: str) -> Queue:
    return Queue(name, Exchange(""), routing_key=name, durable=True)  # type: ignore[no-untyped-call]


def celery_settings(settings: Settings) -> dict[str, Any]:
    """The Celery settings that producer and consumer share."""
    shared: dict[str, Any] = {
        "broker_url": f"{_FILES}://localhost" if settings.uses_broker_of_files else settings.broker_url,
        "broker_connection_retry_on_startup": True,
        # what Redis says that only reads for a while, since another took over or its disk is full, is of this kind
        "broker_channel_error_retry": True,
        "task_serializer": "json",
        "result_serializer": "json",
        "accept_content": ["json"],
        "task_ignore_result": True,
        "result_backend": None,
        # the nameless exchange needs no binding to be kept anywhere
        "task_queues": [_queue(name) for name in (*QUEUES, PREVIEW)],
        "task_create_missing_queues": False,
        "task_default_queue": RENDER,
        "task_default_exchange": "",
        "enable_utc": True,
        "worker_enable_remote_control": False,
    }
    if settings.uses_broker_of_files:
        folder = settings.folder / "broker"
        shared["broker_transport_options"] = {
            "data_folder_in": str(folder / "messages"),
            "data_folder_out": str(folder / "messages"),
            "control_folder": str(folder / "control"),
            "polling_interval": settings.broker_polling_interval_s,
        }
    else:
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
    """The folders of this machine, closed to other users, as is all that this process writes from now on.

    Raises `OSError` when they cannot be made, or are another user's and open to all.
    """
    keep_to_ourselves()
    private_folder(settings.folder)
    if settings.local_storage_folder is not None:
        private_folder(settings.local_storage_folder)
    settings.spool_folder.mkdir(parents=True, exist_ok=True)
    if settings.uses_broker_of_files:
        for name in ("messages", "control"):
            (settings.folder / "broker" / name).mkdir(parents=True, exist_ok=True)


def withdraw(settings: Settings, message: Message) -> None:
    """Take back the message of a job that needs no worker any more, where that costs nothing.

    The embedded broker hands out few messages a second, so those of canceled jobs would hold up the others. Redis hands
    them out at once, and the worker passes over a job that it cannot claim.
    """
    if settings.uses_broker_of_files:
        folder = settings.folder / "broker" / "messages"
        _message_file(folder, message.job_id, message.queue).unlink(missing_ok=True)


def clear_remains(settings: Settings) -> int:
    """Remove what processes that were killed had half written, or taken and not read yet. Returns the number of files.

    A job whose message is lost with it is sent again by the reaper.
    """
    if not settings.uses_broker_of_files:
        return 0
    removed = 0
    for path in (settings.folder / "broker" / "messages").iterdir():
        # a message that is taken gets another name and keeps the time it was written, but not this one
        with suppress(FileNotFoundError):
            if path.suffix in {".draft", ".taken"} and path.stat().st_ctime < time.time() - _REMAINS_S:
                path.unlink()
                removed += 1
    return removed


def sent_jobs(settings: Settings, queue: str) -> set[str] | None:
    """The jobs whose messages the broker holds in a queue, None where it cannot be asked: it may only count them."""
    if not settings.uses_broker_of_files:
        return None
    suffix = f".{queue}.msg"
    names = os.listdir(settings.folder / "broker" / "messages")
    return {name.removesuffix(suffix) for name in names if name.endswith(suffix)}
