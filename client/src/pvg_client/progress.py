"""A bar of a job's progress, by tqdm where it is installed and the standard error is a terminal."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import Any, Final, Self

from pvg_client.models import Job

_IN_MINUTES_S: Final = 90.0
_IN_HOURS_S: Final = 5400.0


class Bar:
    """A bar of 100 parts; nothing at all where none can be shown."""

    def __init__(self, *, wanted: bool) -> None:
        self._bar = _make() if wanted and _is_watched() else None

    @property
    def shown(self) -> bool:
        """True when somebody may be looking."""
        return self._bar is not None

    def show(self, job: Job) -> None:
        """Move it to where the job is."""
        if self._bar is not None:
            self._bar.set_description_str(f"{job.kind}, {_stands(job)}", refresh=False)
            self._bar.set_postfix_str(
                "" if job.eta is None else f"about {_duration(job.eta.seconds)} left", refresh=False
            )
            self._bar.n = round(100 * job.progress.fraction)
            self._bar.refresh()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.close()


def _stands(job: Job) -> str:
    if job.state != "queued":
        return job.progress.stage or job.state
    if job.waiting_for is not None:
        return f"waiting for {job.waiting_for}"
    return "queued" if job.queue_position is None else f"queued, number {job.queue_position}"


def _duration(seconds: float) -> str:
    if seconds < _IN_MINUTES_S:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < _IN_HOURS_S else f"{seconds / 3600:.1f} h"


def _is_watched() -> bool:
    try:
        return sys.stderr is not None and sys.stderr.isatty()  # a program without a console has none
    except ValueError:
        return False  # it is closed


def _make() -> Any:
    try:
        from tqdm import tqdm  # noqa: PLC0415 - it may not be there
    except ImportError:
        return None
    return tqdm(total=100, bar_format="{desc} {percentage:3.0f}%|{bar}| {elapsed}{postfix}")
