"""Figures for Prometheus: requests as this process answers them, and jobs as the records have them when asked.

No figure has an id, a key or a name of a client in its labels. A process knows its own requests alone; the figures of
jobs are the same from every process of the API.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Final

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector
from starlette.types import Scope

from service.catalog import JobKind
from service.catalog.messages import QUEUE_OF
from service.catalog.models import ENDED, JobState
from service.catalog.statistics import Statistics

_METHODS: Final = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})
#: seconds; the last ones are of long polls and large files
_BUCKETS: Final = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10, 30, 60, 300)
_STATES: Final = ("queued", "waiting", "running", "canceling")


class Meters:
    """The figures of one process."""

    def __init__(self) -> None:
        self._registry = CollectorRegistry(auto_describe=False)
        ProcessCollector(registry=self._registry)
        self._requests = Counter(
            "pvg_http_requests", "Requests answered.", ("route", "method", "status"), registry=self._registry
        )
        self._seconds = Histogram(
            "pvg_http_request_duration_seconds",
            "Time until the last byte of the answer was sent.",
            ("route", "method"),
            buckets=_BUCKETS,
            registry=self._registry,
        )
        self._open = Gauge("pvg_http_requests_in_progress", "Requests being answered.", registry=self._registry)
        self._routes: dict[str, str] = {}

    def name_routes(self, routes: Mapping[str, str]) -> None:
        """Say which path template stands for which operation; others are counted as `other`."""
        self._routes.update(routes)

    def begin(self) -> None:
        """A request has come."""
        self._open.inc()

    def end(self, scope: Scope, status: int, seconds: float) -> None:
        """A request was answered, or broken off: status 0."""
        self._open.dec()
        operation = getattr(scope.get("endpoint"), "__name__", "")
        route = self._routes.get(operation, "other")
        method = scope["method"] if scope["method"] in _METHODS else "OTHER"
        self._requests.labels(route, method, str(status)).inc()
        self._seconds.labels(route, method).observe(seconds)

    def text(self, found: Statistics | None, free_bytes: int, reaper_idle_s: float) -> bytes:
        """The figures in Prometheus' text format; without ``found`` the records cannot be reached."""
        jobs = CollectorRegistry(auto_describe=False)
        jobs.register(_Jobs(found, free_bytes, reaper_idle_s))
        return generate_latest(self._registry) + generate_latest(jobs)


class _Jobs(Collector):
    """What the records say, once."""

    def __init__(self, found: Statistics | None, free_bytes: int, reaper_idle_s: float) -> None:
        self._found = found
        self._free_bytes = free_bytes
        self._reaper_idle_s = reaper_idle_s

    def collect(self) -> Iterator[Metric]:
        """The figures."""
        up = 0 if self._found is None else 1
        yield GaugeMetricFamily("pvg_database_up", "Whether the records can be reached.", value=up)
        yield GaugeMetricFamily("pvg_free_disk_bytes", "Free on the fullest disk of the data.", value=self._free_bytes)
        yield GaugeMetricFamily(
            "pvg_reaper_idle_seconds",
            "Since this process's reaper last went through all of its steps.",
            value=self._reaper_idle_s,
        )
        if self._found is not None:
            yield from _of_jobs(self._found)
            yield from _of_workers(self._found)
            yield from _of_what_is_kept(self._found)


def _of_jobs(found: Statistics) -> Iterator[Metric]:
    queues = sorted({*QUEUE_OF.values(), *(queue for queue, _ in found.active)})
    yield _gauge(
        "pvg_jobs",
        "Jobs that have not ended; waiting ones wait for media, queued ones for a worker.",
        ("queue", "state"),
        (((queue, state), found.active.get((queue, state), 0)) for queue in queues for state in _STATES),
    )
    yield _gauge(
        "pvg_parts",
        "Shares of jobs that are done in parts: queued ones wait for a worker, others have one.",
        ("state",),
        (((state,), found.parts.get(state, 0)) for state in ("queued", "running", "canceling")),
    )
    yield _gauge(
        "pvg_jobs_repeated",
        "Jobs that have not ended and are at a second attempt or a later one.",
        ("queue",),
        (((queue,), found.repeated.get(queue, 0)) for queue in queues),
    )
    yield _gauge(
        "pvg_queue_oldest_seconds",
        "For how long the first of those that wait for a worker has waited.",
        ("queue",),
        (((queue,), found.oldest_s.get(queue, 0.0)) for queue in queues),
    )
    ended = CounterMetricFamily("pvg_jobs_ended", "Jobs that have ended.", labels=("kind", "state"))
    kinds = sorted({*(kind.value for kind in JobKind), *(kind for kind, _ in found.ended)})
    for kind in kinds:
        for state in ENDED:
            ended.add_metric((kind, JobState(state).value), found.ended.get((kind, state), 0))
    yield ended


def _of_workers(found: Statistics) -> Iterator[Metric]:
    ready = found.workers.get("", 0)
    yield _gauge(
        "pvg_workers",
        "Pool processes that are alive; lacking ones cannot work, see /readyz.",
        ("state",),
        ((("ready",), ready), (("lacking",), sum(found.workers.values()) - ready)),
    )
    yield GaugeMetricFamily("pvg_preview_workers", "Workers of previews that are ready.", value=found.preview_workers)
    yield _gauge(
        "pvg_previews",
        "Single pictures that somebody waits for: asked for, and taken by a worker.",
        ("state",),
        (((state,), found.previews.get(state, 0)) for state in ("asked", "taken")),
    )


def _of_what_is_kept(found: Statistics) -> Iterator[Metric]:
    yield _gauge(
        "pvg_webhooks",
        "Webhooks that are not delivered: waiting for their job, pending, or given up.",
        ("state",),
        (((state,), found.deliveries.get(state, 0)) for state in ("waiting", "pending", "failed")),
    )
    yield GaugeMetricFamily("pvg_uploads", "Files that have begun to arrive in pieces.", value=found.uploads)
    yield _gauge(
        "pvg_stored_bytes",
        "Bytes of what is kept.",
        ("what",),
        (((what,), size) for what, size in found.stored.items()),
    )
    yield GaugeMetricFamily("pvg_blobs_to_delete", "Files that are still to be deleted.", value=found.tombstones)
    yield GaugeMetricFamily(
        "pvg_collector_halted", "Whether files without a record are kept, see /readyz.", value=int(found.is_halted)
    )


def _gauge(
    name: str, text: str, labels: tuple[str, ...], values: Iterable[tuple[tuple[str, ...], float]]
) -> GaugeMetricFamily:
    family = GaugeMetricFamily(name, text, labels=labels)
    for of_one, value in values:
        family.add_metric(of_one, value)
    return family
