"""From the method's progress, stage by stage, to one fraction of the whole job."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from service.catalog import Progress


class ProgressScale:
    """Maps (stage, done, total) onto the spans of [0, 1] that the stages are known to take.

    The fraction never falls; a stage without a span keeps it where it is.
    """

    def __init__(self, report: Callable[[Progress], None]) -> None:
        self._report = report
        self._spans: Mapping[str, tuple[float, float]] = {}
        self._fraction = 0.0

    def expect(self, spans: Mapping[str, tuple[float, float]]) -> None:
        """The spans of the stages that come next."""
        self._spans = spans

    def __call__(self, stage: str, done: int, total: int) -> None:
        """The method's progress callback. Raises when the work has to stop."""
        start, end = self._spans.get(stage, (self._fraction, self._fraction))
        part = min(1.0, done / total) if total > 0 else 0.0
        self._fraction = max(self._fraction, start + (end - start) * part)
        self._report(Progress(stage, round(self._fraction, 4), done, max(done, total)))
