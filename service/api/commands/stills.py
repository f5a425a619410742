"""The use case of single pictures: asked for by a record, made by a worker of previews, waited for and answered."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import timedelta
from typing import Any, Final

from sqlalchemy.orm import Session
from starlette.responses import Response, StreamingResponse

from service.api.absences import no_face, no_frame, no_medium
from service.api.ranges import matches
from service.api.services import Services
from service.catalog import Media, MediaState, PreviewState, Role, StillRequest, media, previews, workers
from service.catalog.requests import to_json
from service.catalog.retention import is_kept
from service.errors import (
    PROBLEMS,
    ConflictError,
    Limit,
    MediaFailedError,
    NotFoundError,
    QuotaExceededError,
    ServiceError,
    UnavailableError,
    ValidationFailedError,
    limit_of,
    of_medium,
    problem_body,
)
from service.storage import BlobMissingError

#: says which frame a picture shows
FRAME_HEADER: Final = "Pvg-Frame"
MEDIA_TYPES: Final = {"jpeg": "image/jpeg", "png": "image/png"}
#: as the worker makes them, see `worker.sandbox.calls`
POSTER_PX: Final = 640
THUMBNAIL_PX: Final = 160
#: of how pictures are made: another one when the same request makes another picture
_EDITION: Final = 2
_RETRY_S: Final = "1"
#: statuses from here on are of the service, not of what it was asked for (RFC 9110, 15)
_FIRST_OF_OURS: Final = 500


@dataclass(frozen=True)
class WantedStill:
    """A single picture of a medium. ``pointers`` says where in the request's JSON each id stands, for errors."""

    media_id: str
    reference_id: str | None
    request: StillRequest
    pointers: Mapping[str, str | None]


class StillFailedError(ServiceError):
    """There is no such picture, for a reason that the worker tells: with 422 when it is of the medium."""

    def __init__(self, error: Mapping[str, Any]) -> None:
        known, of_medium = PROBLEMS[str(error["type"])], ValidationFailedError.kind.status
        self._known = known if known.status >= _FIRST_OF_OURS else replace(known, status=of_medium)
        again = self._known.status == UnavailableError.kind.status
        headers = {"Retry-After": _RETRY_S} if again else None
        super().__init__(str(error["detail"]), errors=error.get("errors", ()), headers=headers, limit=limit_of(error))

    def problem(self) -> dict[str, Any]:
        """The problem as the worker names it."""
        return problem_body(self._known, self.detail, self.errors, self.limit)


def usable(session: Session, owner: str, media_id: str, where: str | None = None) -> Media:
    """A medium that is ready. Raises `NotFoundError`, `MediaFailedError`, and `ConflictError` while it is not."""
    found = media.get(session, media_id, owner=owner)
    if found is None:
        detail = no_medium(media_id)
        raise NotFoundError(detail, errors=[] if where is None else [{"pointer": where, "detail": detail}])
    if found.state == MediaState.FAILED and found.error is not None:
        error = of_medium(found.error, media_id)
        raise MediaFailedError(error, {} if where is None else {where: error})
    check_ready(found)
    return found


def check_ready(found: Media) -> None:
    """Raise `ConflictError` for a medium that is not ready."""
    if found.state != MediaState.READY:
        raise ConflictError(f"{found.id} is still being vectorised; wait for its job {found.job_id}")


async def picture(
    services: Services, owner: str, wanted: WantedStill, *, if_none_match: str | None, is_use: bool = True
) -> Response:
    """The picture, or 304 for who has it already; a use of its media, whose retention counts from it, if ``is_use``.

    Raises what `usable` raises, `QuotaExceededError`, `UnavailableError` when no worker makes it in time, and
    `StillFailedError` when there is none.
    """
    mark, unused = await services.calls.read(_check, services, owner, wanted)
    if unused and is_use:
        await services.calls.write(_use, services, unused)
    headers = {"ETag": f'W/"{mark[:32]}"', "Cache-Control": "private, no-cache"}
    if matches(if_none_match, f'"{mark[:32]}"'):
        return Response(status_code=304, headers=headers)
    preview_id, is_new = await services.calls.write(_ask, services, owner, wanted, mark)
    if is_new:
        await _send(services, preview_id)
    made = await services.previews.end_of(preview_id, services.settings.preview_timeout_s)
    if made is None:
        # no worker begins it any more: whoever waits for it, here or elsewhere, does better to ask again
        await services.calls.write(_drop, services, preview_id)
        await services.calls.read(_check, services, owner, wanted)  # a medium may be deleted meanwhile
        raise _unavailable("the picture was not made in time; try again")
    if made.state == PreviewState.FAILED and made.error is not None:
        raise StillFailedError(made.error)
    assert made.blob_key is not None  # noqa: S101 - a picture that is made has both
    assert made.size_bytes is not None  # noqa: S101
    headers[FRAME_HEADER] = str(made.frame)
    try:
        return await _stream(services, made.blob_key, 0, made.size_bytes, headers, wanted.request.format)
    except BlobMissingError as error:  # deleted with its medium, or after its time
        await services.calls.read(_check, services, owner, wanted)
        raise _unavailable("the picture is gone; ask again") from error


def _check(services: Services, owner: str, wanted: WantedStill) -> tuple[str, list[str]]:
    """What the picture depends on, as a hash, and the media that have not been used for a while.

    Raises what `usable` raises, and `UnavailableError` without a worker.
    """
    now, ttl_s = services.database.now(), services.settings.media_ttl_s
    with services.database.read() as session:
        found = [usable(session, owner, media_id, where) for media_id, where in wanted.pointers.items()]
        since = now - timedelta(seconds=services.settings.silent_s)
        alive = workers.lacking(session, since=since, kind="previews")
    if None not in alive:
        raise _unavailable("no worker makes pictures right now")
    assets = sorted([one.id, one.asset_key] for one in found)
    told = json.dumps([_EDITION, wanted.media_id, assets, to_json(wanted.request)], sort_keys=True)
    unused = [one.id for one in found if not is_kept(one.expires_at, now=now, ttl_s=ttl_s)]
    return hashlib.sha256(told.encode()).hexdigest(), unused


def _use(services: Services, media_ids: list[str]) -> None:
    with services.database.write() as session:
        used = media.locked(session, media_ids)
        media.use(used, now=services.database.now(), ttl_s=services.settings.media_ttl_s)


def _ask(services: Services, owner: str, wanted: WantedStill, mark: str) -> tuple[str, bool]:
    database, most = services.database, services.settings.max_open_previews
    within_s = services.settings.preview_timeout_s
    with database.write() as session:
        now = database.now()
        # until the end of the transaction they cannot be deleted: whoever deletes them then finds the record
        for media_id in sorted(wanted.pointers):
            if media.get(session, media_id, owner=owner, lock="share") is None:
                raise NotFoundError(f"{media_id} was deleted")
        preview, is_new = previews.ask(
            session,
            wanted.request,
            owner=owner,
            media_id=wanted.media_id,
            reference_id=wanted.reference_id,
            fingerprint=mark,
            now=now,
            within_s=within_s,
        )
        if is_new and previews.open_count(session, owner, now=now, within_s=within_s) > most:
            raise QuotaExceededError(
                f"{most} pictures are being made already; wait for them",
                headers={"Retry-After": _RETRY_S},
                limit=Limit(most, "pictures"),
            )
        return preview.id, is_new


async def _send(services: Services, preview_id: str) -> None:
    try:
        await services.calls.read(services.publisher.ask, preview_id)
    except Exception as error:
        await services.calls.write(_drop, services, preview_id)
        raise _unavailable("the queue does not answer; try again") from error


def _drop(services: Services, preview_id: str) -> None:
    with services.database.write() as session:
        previews.drop(session, preview_id)
    services.publisher.withdraw_preview(preview_id)


async def _stream(
    services: Services, key: str, start: int, end: int, headers: Mapping[str, str], kind: str
) -> StreamingResponse:
    """The bytes [start, end) of a blob as they are read: who takes them slowly keeps no copy of the whole in memory.

    Raises `BlobMissingError`.
    """
    pieces = await services.storage.stream(key, start, end)
    return StreamingResponse(
        pieces, headers={**headers, "Content-Length": str(end - start)}, media_type=MEDIA_TYPES[kind]
    )


def _unavailable(detail: str) -> UnavailableError:
    error = UnavailableError(detail)
    error.headers["Retry-After"] = _RETRY_S
    return error


async def small_picture(
    services: Services, owner: str, role: Role, media_id: str, face: int | None, *, if_none_match: str | None
) -> Response:
    """A medium's poster, or the thumbnail of a face, as it was made with the asset; else, or if that is lost, made now.

    Raises as `picture` does, and `NotFoundError` for a face that is not there.
    """
    medium = await services.calls.read(_of_role, services, owner, role, media_id)
    if face is not None and face >= len(medium.faces):
        raise NotFoundError(no_face(medium, face))
    found = media.picture_of(medium, face)
    if found is not None:
        key, start, end = found
        etag = f'"{hashlib.sha256(f"{key} {start}".encode()).hexdigest()[:32]}"'
        headers = {"ETag": etag, "Cache-Control": "private, no-cache"}
        if matches(if_none_match, etag):
            return Response(status_code=304, headers=headers)
        with suppress(BlobMissingError):
            return await _stream(services, key, start, end, headers, "jpeg")
    request = StillRequest("jpeg", THUMBNAIL_PX if face is not None else POSTER_PX, face=face)
    wanted = WantedStill(media_id, None, request, {media_id: None})
    return await picture(services, owner, wanted, if_none_match=if_none_match, is_use=False)


def _of_role(services: Services, owner: str, role: Role, media_id: str) -> Media:
    with services.database.read() as session:
        found = usable(session, owner, media_id)
    if found.role != role:
        raise NotFoundError(f"there is no {role.value} {media_id}")
    return found


async def layer(
    services: Services, owner: str, role: Role, media_id: str, request: StillRequest, *, if_none_match: str | None
) -> Response:
    """A layer of a frame. Raises as `picture` does, and `NotFoundError` for a frame that is not there."""
    medium = await services.calls.read(_of_role, services, owner, role, media_id)
    count = frame_count(medium)
    if request.frame is not None and request.frame >= count:
        raise NotFoundError(no_frame(medium, count))
    wanted = WantedStill(media_id, None, request, {media_id: None})
    return await picture(services, owner, wanted, if_none_match=if_none_match)


def frame_count(medium: Media) -> int:
    """How many frames a medium has that is ready."""
    return int((medium.info or {}).get("frame_count", 1))
