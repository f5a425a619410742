"""The answers that show records."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from datetime import datetime, timedelta
from typing import Any, Final, Literal, cast

from service import addresses
from service.api.schemas import (
    ExtraBody,
    JobBody,
    LookBody,
    MediaBody,
    OptionsBody,
    OutputBody,
    ProgressBody,
    State,
    VectorBody,
)
from service.catalog import (
    DEFAULT_VECTOR_SETTINGS,
    ENDED,
    Job,
    JobKind,
    JobState,
    Look,
    Media,
    MediaState,
    Result,
    leases,
    look_params,
    render_request,
    vector_settings,
)
from service.catalog.forecast import Forecast
from service.errors import shown
from service.settings import Settings

_UNKNOWN: Final = Forecast()


def media_body(media: Media, settings: Settings) -> MediaBody:
    """The answer that shows a medium."""
    at = addresses.of_media(settings, media.role, media.id)
    is_ready = media.state == MediaState.READY
    return MediaBody.model_validate(
        {
            "id": media.id,
            "state": media.state,
            "job": media.job_id,
            "filename": media.filename,
            "content_type": media.content_type,
            "size_bytes": media.size_bytes,
            "sha256": media.sha256,
            "settings": VectorBody(**asdict(vector_settings(media))),
            "media": media.info,
            "poster": f"{at}/poster" if is_ready else None,
            "faces": [
                {**face, "thumbnail": f"{at}/faces/{face['index']}/thumbnail" if is_ready else None}
                for face in media.faces
            ],
            "warnings": media.warnings,
            "metadata": media.metadata_,
            "error": shown(media.error, settings.root_path),
            "created_at": media.created_at,
            "expires_at": media.expires_at,
        }
    )


def job_body(
    job: Job,
    looks: Sequence[Look],
    files: Mapping[str, Sequence[Result]],
    kept: Mapping[str, datetime],
    settings: Settings,
    *,
    medium_until: datetime | None = None,
    no_room: bool = False,
    forecast: Forecast = _UNKNOWN,
) -> JobBody:
    """The answer that shows a job.

    ``files`` are its results, each with its parts, by the result's id, as `by_result` has them; they may be those of
    other jobs too. ``kept`` says until when results and parts are kept, by their ids, and ``medium_until`` until when
    the medium is that it has made. ``no_room`` says that the disk is full, so that jobs wait, and ``forecast`` is what
    is likely of it.

    A look shares its job's state: all are rendered together.
    """
    made = [kept[one.id] for look in looks if look.result_id for one in files.get(look.result_id, ())]
    made += [] if medium_until is None else [medium_until]
    return JobBody.model_validate(
        {
            "id": job.id,
            "kind": job.kind,
            "state": job.state,
            "done": job.state in ENDED,
            "attempt": job.attempt,
            "waiting_for": _waiting_for(job, no_room),
            "progress": ProgressBody(
                # `waiting_for` says it
                stage=None if job.stage == leases.NO_ROOM else job.stage,
                fraction=job.fraction,
                frames_done=job.frames_done,
                frames_total=job.frames_total,
            ),
            "queue": None if forecast.position is None else {"position": forecast.position},
            "eta": _eta(forecast),
            "media": job.media_id,
            "looks": [_look_body(job, look, files, kept, settings) for look in looks],
            "output": None if job.kind == JobKind.VECTORIZE else OutputBody(**asdict(render_request(job).output)),
            "error": shown(job.error, settings.root_path),
            "timings": _timings(job),
            "metadata": job.metadata_,
            "traceparent": job.traceparent,
            "created_at": job.created_at,
            "started_at": job.started_at,
            "finished_at": job.finished_at,
            "expires_at": _expires_at(job, made, settings),
        }
    )


def _expires_at(job: Job, made: Iterable[datetime], settings: Settings) -> datetime | None:
    """When the record of a job may go: not before what it has ``made``, which is kept until then."""
    if job.finished_at is None:
        return None
    return max([job.finished_at + timedelta(seconds=settings.job_ttl_s), *made])


def _timings(job: Job) -> dict[str, float] | None:
    """What is known of them: what the worker measures is recorded at the end, when it began is known before."""
    known = dict(job.timings or {})
    if job.state != JobState.QUEUED and job.started_at is not None and job.started_at >= job.queued_at:
        known.setdefault("queued_s", round((job.started_at - job.queued_at).total_seconds(), 3))
    return known or None


def _eta(forecast: Forecast) -> dict[str, float] | None:
    eta = forecast.eta
    if eta is None:
        return None
    return {"seconds": round(eta.seconds, 1), "low": round(eta.low, 1), "high": round(eta.high, 1)}


def _waiting_for(job: Job, no_room: bool) -> str | None:
    if job.state != JobState.QUEUED:
        return None
    if job.waiting:
        return "media"
    return "room" if no_room or job.stage == leases.NO_ROOM else None


def _settings(report: dict[str, Any]) -> VectorBody:
    # a former version's report does not say what had no choice then
    return VectorBody(**{name: report.get(name, usual) for name, usual in asdict(DEFAULT_VECTOR_SETTINGS).items()})


def by_result(files: Iterable[Result]) -> dict[str, list[Result]]:
    """Results and parts of results, in their order, by the id of the result that each is or belongs to."""
    found: defaultdict[str, list[Result]] = defaultdict(list)
    for one in files:
        found[one.part_of or one.id].append(one)
    return found


def _look_body(
    job: Job, look: Look, files: Mapping[str, Sequence[Result]], kept: Mapping[str, datetime], settings: Settings
) -> LookBody:
    report = look.report
    mine = files.get(look.result_id, ()) if look.result_id else ()
    result = next((one for one in mine if one.part_of is None), None)
    url = addresses.of_result(settings, look.result_id) if look.result_id else None
    return LookBody(
        state=cast("State", job.state),
        video=look.video_id,
        reference=look.reference_id,
        # what a former version did not write is its default
        options=OptionsBody.model_validate(asdict(look_params(look))),
        settings=None if report is None else _settings(report),
        warnings=[] if report is None else report["warnings"],
        result=look.result_id,
        result_gone=cast("Literal['expired', 'deleted'] | None", look.result_gone),
        url=url,
        size_bytes=None if result is None else result.size_bytes,
        content_type=None if result is None else result.content_type,
        sha256=None if result is None else result.sha256,
        expires_at=None if result is None else kept[result.id],
        # bytes of a result and its parts go in one sweep, or in two
        extras=[
            _extra_body(part, url, kept[part.id]) for part in mine if url and part.part_of is not None and part.blob_key
        ],
    )


def _extra_body(part: Result, url: str, expires_at: datetime) -> ExtraBody:
    person = part.person or 1
    return ExtraBody.model_validate(
        {
            "part": part.part,
            "person": person,
            "url": f"{url}/{part.part}" + (f"?person={person}" if person > 1 else ""),
            "size_bytes": part.size_bytes,
            "sha256": part.sha256,
            "content_type": part.content_type,
            "expires_at": expires_at,
        }
    )
