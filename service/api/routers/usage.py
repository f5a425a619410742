"""/limits and /usage: what the caller may do, and how much of it is used."""

from __future__ import annotations

from dataclasses import asdict

from fastapi import APIRouter

from service.api import fetches, quotas, streams
from service.api.authentication import CallerDep
from service.api.commands import pieces
from service.api.dependencies import MAX_PAGE, MAX_WAIT_S, ServicesDep, problems
from service.api.schemas import (
    MAX_LINK_S,
    MAX_METADATA,
    KeyLimits,
    LimitsBody,
    MonthBody,
    OutputLimits,
    RequestLimits,
    RequestsUsed,
    RetentionLimits,
    TransportLimits,
    UploadLimits,
    UsageBody,
    Used,
)
from service.api.services import Services
from service.api.sniffing import FORMATS
from service.catalog import HELD, IMAGE_CONTAINERS, MAX_CRF, amounts, keys, ledger
from service.catalog.windows import WINDOW_S
from service.egress import MAX_REDIRECTS, MAX_URL_CHARACTERS

router = APIRouter(tags=["service"])


@router.get("/limits", responses=problems())
async def get_limits(services: ServicesDep, caller: CallerDep) -> LimitsBody:
    """List the limits that apply to the caller, and the available formats, codecs and ranges."""
    return await services.calls.read(_limits, services, caller.owner)


@router.get("/usage", responses=problems())
async def get_usage(services: ServicesDep, caller: CallerDep) -> UsageBody:
    """Tell what the caller has used of its limits and has had done by month; without keys, what all callers have."""
    return await services.calls.read(_usage, services, caller.owner)


def _limits(services: Services, owner: str) -> LimitsBody:
    settings = services.settings
    with services.database.read() as session:
        key = keys.get(session, owner)
    allowed = None if key is None else keys.limits_of(key)
    return LimitsBody(
        key=None if allowed is None else KeyLimits(**asdict(allowed)),
        upload=UploadLimits(
            bytes=settings.max_upload_bytes,
            pixels=settings.max_pixels,
            frames=settings.max_frames,
            duration_s=settings.max_duration_s,
            frame_rate=settings.max_frame_rate,
            streams=settings.max_streams,
            face_px=settings.min_face_px,
            advised_face_px=settings.warn_face_px,
            formats=list(FORMATS),
        ),
        request=RequestLimits(
            json_bytes=settings.max_json_bytes,
            looks=settings.max_looks,
            metadata=MAX_METADATA,
            wait_s=MAX_WAIT_S,
            page=MAX_PAGE,
            idempotency_s=settings.idempotency_ttl_s,
        ),
        transport=TransportLimits(
            fetches=fetches.PER_OWNER,
            fetch_s=settings.fetch_timeout_s,
            redirects=MAX_REDIRECTS,
            url_characters=MAX_URL_CHARACTERS,
            uploads=quotas.MAX_OPEN_UPLOADS,
            pieces=pieces.MAX_PARTS,
            link_s=MAX_LINK_S,
            streams=streams.PER_OWNER,
            previews=settings.max_open_previews,
            preview_s=settings.preview_timeout_s,
        ),
        output=OutputLimits(
            clips={container: list(codecs) for container, codecs in HELD.items()},
            pictures=list(IMAGE_CONTAINERS),
            crf=MAX_CRF,
        ),
        retention=RetentionLimits(
            media_s=settings.media_ttl_s,
            uploads_s=settings.upload_ttl_s,
            results_s=settings.result_ttl_s,
            jobs_s=settings.job_ttl_s,
            queued_s=settings.max_queued_s,
            usage_months=settings.usage_months,
        ),
    )


def _usage(services: Services, owner: str) -> UsageBody:
    now = services.database.now()
    with services.database.read() as session:
        key = keys.get(session, owner)
        months = [MonthBody.model_validate(asdict(one)) for one in ledger.months(session, owner, now=now)]
        active, stored = amounts.active_jobs(session, owner), amounts.stored_bytes(session, owner)
    limits = None if key is None else keys.limits_of(key)
    window, second = divmod(int(now.timestamp()), WINDOW_S)
    counted = key is not None and key.window_number == window
    return UsageBody(
        requests=RequestsUsed(
            used=key.window_requests if key is not None and counted else 0,
            limit=limits.requests_per_minute if limits else None,
            resets_s=WINDOW_S - second if limits else None,
        ),
        active_jobs=Used(used=active, limit=limits.active_jobs if limits else None),
        stored_bytes=Used(used=stored, limit=limits.stored_bytes if limits else None),
        looks_this_month=months[0].looks,
        jobs_this_month=months[0].jobs,
        months=months,
    )
