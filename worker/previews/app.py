"""The Celery app of previews. Its pool is of threads: they share the clips that are open, and only wait themselves."""

from __future__ import annotations

import os
from functools import cache
from typing import Final

from celery import Celery
from celery.signals import setup_logging, worker_init, worker_shutdown, worker_shutting_down

from pvg._processors import usable_processors
from service.logs import configure
from service.queue import PREVIEW_TASK, celery_settings, make_folders
from service.settings import Settings
from worker import connection, lifeline, stopping
from worker.beginning import or_end
from worker.heartbeat import Heartbeat
from worker.previews.previewer import Previewer
from worker.sandbox import Sandbox, SandboxServer

#: somebody waits for these: they go before renders, and after the API
_NICE: Final = 3

settings = Settings()

for _name in ("OPENCV_FOR_THREADS_NUM", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, str(usable_processors()))

make_folders(settings)

sandbox = SandboxServer(str(settings.folder), nice=_NICE)
_heartbeat = Heartbeat(settings, kind="previews")

app = Celery("pvg-previews")
app.steps["consumer"].add(connection.Watched)
app.conf.update(celery_settings(settings))
app.conf.update(connection.SETTINGS)
app.conf.update(
    worker_pool="threads",
    worker_concurrency=settings.preview_concurrency,
    # the embedded broker is looked at so often; others speak by themselves
    broker_transport_options={
        **app.conf.broker_transport_options,
        **({"polling_interval": settings.preview_polling_interval_s} if settings.uses_broker_of_files else {}),
    },
)


@cache
def _previewer() -> Previewer:
    return Previewer(settings, Sandbox(sandbox.lobby))


@setup_logging.connect  # type: ignore[untyped-decorator]
def _set_up_logging(**_: object) -> None:
    configure(settings.log_level)


@worker_init.connect  # type: ignore[untyped-decorator]
def _begin(**_: object) -> None:
    configure(settings.log_level)  # Celery asks for it later
    with or_end():
        lifeline.die_with_starter()
        sandbox.start()
        _previewer().start()
        connection.lose()  # there is none yet
        _heartbeat.start()


@worker_shutting_down.connect  # type: ignore[untyped-decorator]
def _stop(**_: object) -> None:
    stopping.end_within(settings.worker_stop_limit_s)


@worker_shutdown.connect  # type: ignore[untyped-decorator]
def _leave(**_: object) -> None:
    _heartbeat.stop()
    _previewer().stop()


@app.task(name=PREVIEW_TASK)  # type: ignore[untyped-decorator]
def make_preview(_preview_id: str) -> None:
    """Make a picture that somebody waits for: the one that is named, or another one whose turn it is."""
    _previewer().take_turn()
