"""The Celery app of the worker."""

from __future__ import annotations

import logging
import os

from celery import Celery
from celery.signals import (
    setup_logging,
    worker_init,
    worker_process_init,
    worker_process_shutdown,
    worker_shutting_down,
)
from celery.utils.log import get_multiprocessing_logger

from pvg._processors import usable_processors
from service.logs import configure
from service.queue import celery_settings, make_folders
from service.settings import Settings
from worker import connection, lifeline, stopping
from worker.beginning import or_end
from worker.heartbeat import Heartbeat, wait_for_weights
from worker.sandbox import SandboxServer

settings = Settings()

# several jobs share the cores; the numeric libraries read these as they are loaded
_THREADS = str(max(1, usable_processors() // settings.worker_concurrency))
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
    os.environ.setdefault(_name, _THREADS)

make_folders(settings)

#: started with the worker's main process, before its pool
sandbox = SandboxServer(str(settings.folder))
#: of a pool process; a thread is made before it is forked, and started after
_heartbeat = Heartbeat(settings)

app = Celery("pvg-worker", include=["worker.tasks"])
app.steps["consumer"].add(connection.Watched)
app.conf.update(celery_settings(settings))
app.conf.update(connection.SETTINGS)
app.conf.update(
    task_acks_late=True,
    task_reject_on_worker_lost=True,
    worker_pool="worker.pool:TaskPool",
    worker_concurrency=settings.worker_concurrency,
    worker_max_tasks_per_child=settings.worker_max_tasks_per_child,
    worker_max_memory_per_child=settings.worker_max_memory_per_child_bytes // 1024,  # Celery counts in KiB
    # a job's time is kept by its supervisor; this is for a supervisor that hangs
    task_time_limit=settings.job_hard_limit_s,
    # a render goes on while the broker is away: the database is the source of truth
    worker_cancel_long_running_tasks_on_connection_loss=False,
)


logging.getLogger("celery.worker.request").addFilter(stopping.is_no_loss)


@setup_logging.connect  # type: ignore[untyped-decorator]
def _set_up_logging(**_: object) -> None:
    # when it is first asked for, it gets a way of its own
    get_multiprocessing_logger().addFilter(stopping.is_no_fault)
    configure(settings.log_level)


@worker_init.connect  # type: ignore[untyped-decorator]
def _tie_worker(**_: object) -> None:
    configure(settings.log_level)  # Celery asks for it later
    with or_end():
        lifeline.die_with_starter()
        wait_for_weights(settings)
        sandbox.start()  # the pool takes no job before it can do one
        connection.lose()  # there is none yet


@worker_process_init.connect  # type: ignore[untyped-decorator]
def _tie_child(**_: object) -> None:
    with or_end():
        lifeline.die_with_parent()
        _heartbeat.start()


@worker_process_shutdown.connect  # type: ignore[untyped-decorator]
def _leave(**_: object) -> None:
    _heartbeat.stop()


@worker_shutting_down.connect  # type: ignore[untyped-decorator]
def _stop(**_: object) -> None:
    stopping.ask()
    stopping.end_within(settings.worker_stop_limit_s)
