"""Looks that are asked for: checked, and recorded as a job."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel

from service import addresses
from service.api import lookups, quotas
from service.api.commands.asked import Asked
from service.api.commands.checks import WantedLook, WantedOutput, check, check_apart
from service.api.schemas import USUAL_CONTAINERS, JobBody, LookOptions, OutputRequest
from service.api.services import Services
from service.catalog import (
    JobKind,
    LookParams,
    MediaState,
    NewLook,
    OutputOptions,
    RenderRequest,
    jobs,
    media,
    results,
    webhooks,
)
from service.errors import UnavailableError
from service.outages import is_outage


def check_looks(
    services: Services,
    owner: str,
    looks: Sequence[WantedLook],
    output: WantedOutput,
    places: Mapping[str, str],
) -> None:
    """Raise what `request_looks` would raise for such media and options, and record nothing."""
    with services.database.read() as session:
        check(media.several(session, owner, {*places.values()}), looks, output, places)


async def find_lost(
    services: Services, kind: JobKind, looks: Sequence[WantedLook], output: WantedOutput, asked: Asked
) -> str | None:
    """The id of the owner's job of the same looks, if the storage has lost a file of its results.

    None also where the storage does not say.
    """
    if asked.force:
        return None
    job_id, keys = await services.calls.read(_same, services, kind, looks, output, asked)
    try:
        has_lost = bool(keys) and await services.calls.ask_store(_has_lost, services, keys)
    except Exception as error:
        if not isinstance(error, UnavailableError) and not is_outage(error):
            raise
        return None
    return job_id if has_lost else None


def _same(
    services: Services, kind: JobKind, looks: Sequence[WantedLook], output: WantedOutput, asked: Asked
) -> tuple[str | None, list[str]]:
    """The owner's job of the same looks, and the blobs of its results."""
    _, _, mark = _wanted(kind, looks, output, asked)
    with services.database.read() as session:
        job = jobs.find_same(session, asked.owner, mark, now=services.database.now())
        return (None, []) if job is None else (job.id, results.keys_of(session, job.id))


def _has_lost(services: Services, keys: Sequence[str]) -> bool:
    return not all(services.storage.exists(key) for key in keys)


def _wanted(
    kind: JobKind, looks: Sequence[WantedLook], output: WantedOutput, asked: Asked
) -> tuple[RenderRequest, list[NewLook], str]:
    """What the job is to record of its output and its looks, and the fingerprint by which the same is found."""
    request = RenderRequest(_output_options(output.options))
    outputs = [NewLook(look.video_id, look.reference_id, params_of(look)) for look in looks]
    return request, outputs, jobs.fingerprint(kind, request, outputs, asked.metadata)


def request_looks(
    services: Services,
    kind: JobKind,
    looks: Sequence[WantedLook],
    output: WantedOutput,
    places: Mapping[str, str],
    asked: Asked,
    *,
    lost: str | None = None,
) -> tuple[JobBody, bool]:
    """Record a job that makes these looks and publish it once its media are ready. Returns it, and True when it is new.

    The owner's job of the same looks is returned instead while it goes on, or while its results are kept, for a full
    retention more, unless ``asked.force``, and unless it is the ``lost`` one of `find_lost`. ``places`` are the ids by
    where in the request they stand, that of a video first. Raises `NotFoundError` for an unknown id,
    `MediaFailedError` for a medium that failed, `ValidationFailedError` for what does not fit the video, and, of a new
    job, `QuotaExceededError` and `StorageFullError` when there is too little room to do it.
    """
    database, owner = services.database, asked.owner
    request, outputs, mark = _wanted(kind, looks, output, asked)
    with database.write() as session:
        now = database.now()
        # until the end of the transaction: no other request of this key is counted, nor asks for the same of this video
        quotas.lock_key(session, owner)
        known = media.several(session, owner, {*places.values()}, lock=True)
        check(known, looks, output, places)
        if kind is JobKind.SWAP:
            check_apart(known, looks[0])
        job = None if asked.force else jobs.find_same(session, owner, mark, now=now)
        if job is not None and (
            job.id == lost or not results.keep(session, job.id, now=now, ttl_s=services.settings.result_ttl_s)
        ):
            job = None
        new = job is None
        if job is None:
            services.room.require()
            quotas.check(session, owner, now=now, lately=services.lately)
            # they stay as they are until the job is recorded: one that is ready later lets it go then
            ready = all(one.state == MediaState.READY for one in known.values())
            job = jobs.create(
                session,
                kind,
                request=request,
                now=now,
                outputs=outputs,
                owner=owner,
                metadata=asked.metadata,
                ready=ready,
            )
        if asked.webhook is not None:
            webhooks.announce(session, job, asked.webhook, now=now)
        media.keep(known.values(), now=now, ttl_s=services.settings.media_ttl_s)
        body = lookups.of_job(services.settings, services.room, session, job, forecasts=services.forecasts)
        location = addresses.of_job(services.settings, job.id)
        asked.once.keep(session, 202 if new else 200, body, location=location, resource_id=job.id)
    if new and not job.waiting:
        services.publisher.publish([jobs.message_of(job)])
    return body, new


def params_of(look: WantedLook) -> LookParams:
    """How a look is asked for, as it is recorded: the options by their names, and whether two faces exchange theirs."""
    options = {name: _recorded(getattr(look.options, name)) for name in LookOptions.model_fields}
    if look.exchange:
        options["contrast"] = look.exchange
    return LookParams(**options, exchange=look.exchange is not None)


def _recorded(value: Any) -> Any:
    """A value of a request as `LookParams` has it: of parts a mapping, of lists a tuple."""
    if isinstance(value, BaseModel):
        return value.model_dump()
    return tuple(value) if isinstance(value, list) else value


def _output_options(output: OutputRequest) -> OutputOptions:
    return OutputOptions(
        # a container that is not of the video's kind is refused, so this says the same as none
        container=None if output.container in USUAL_CONTAINERS else output.container,
        codec=output.codec,
        crf=output.crf,
        preset=output.preset,
        audio=output.audio,
        extras=tuple(output.extras),
        matte=output.matte,
    )
