"""The answers that need several records."""

from __future__ import annotations

from collections.abc import Sequence

from sqlalchemy.orm import Session

from service.api.forecasts import Forecasts
from service.api.schemas import JobBody
from service.api.views import by_result, job_body
from service.catalog import ENDED, Job, JobState, jobs, media, results
from service.catalog.forecast import Forecast
from service.room import Room
from service.settings import Settings


def of_jobs(
    settings: Settings, room: Room, session: Session, found: Sequence[Job], *, forecasts: Forecasts | None = None
) -> list[JobBody]:
    """The answers for jobs, in their order, by few queries; with ``forecasts``, what is likely of them by some more."""
    likely = {} if forecasts is None else forecasts.of(session, found)
    looks = jobs.looks_of(session, [job.id for job in found])
    made = [look.result_id for of_one in looks.values() for look in of_one if look.result_id]
    files = results.files(session, made)
    kept = results.kept_until(session, files)
    media_kept = media.kept_until(session, [job.id for job in found if job.media_id is not None and job.state in ENDED])
    of_results = by_result(files)
    no_room = any(job.state == JobState.QUEUED for job in found) and room.is_short()
    return [
        job_body(
            job,
            looks.get(job.id, ()),
            of_results,
            kept,
            settings,
            medium_until=media_kept.get(job.id),
            no_room=no_room,
            forecast=likely.get(job.id, Forecast()),
        )
        for job in found
    ]


def of_job(
    settings: Settings, room: Room, session: Session, job: Job, *, forecasts: Forecasts | None = None
) -> JobBody:
    """The answer for one job."""
    return of_jobs(settings, room, session, [job], forecasts=forecasts)[0]
