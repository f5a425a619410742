"""/results: finished files, whole or in ranges."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta
from urllib.parse import urlencode

from fastapi import APIRouter, Request, Response
from sqlalchemy.orm import Session
from starlette.responses import StreamingResponse

from service import addresses
from service.api.authentication import Caller, CallerDep
from service.api.dependencies import IfMatch, PersonNumber, ResultId, ServicesDep, problems
from service.api.downloads import (
    CLIPS,
    PICTURES,
    BytesAsked,
    BytesAskedDep,
    File,
    etag_of_file,
    file_answers,
    send_file,
)
from service.api.idempotency import Once, OnceDep
from service.api.json_body import has_body, read_json
from service.api.links import Access, AccessDep
from service.api.openapi import json_body
from service.api.ranges import require_match
from service.api.schemas import LinkBody, ResultLinkRequest
from service.api.services import Services
from service.catalog import PartName, Result, keys, results
from service.errors import GoneError, NotFoundError

router = APIRouter(prefix="/results", tags=["results"])
#: what a link opens as well as a key does
open_router = APIRouter(prefix="/results", tags=["results"])


@dataclass(frozen=True)
class _Kept:
    """A result or a part of one whose bytes are in the storage under ``key``."""

    result: Result
    key: str
    until: datetime


@open_router.get(
    "/{result_id}",
    response_class=StreamingResponse,
    responses={**file_answers(*CLIPS, *PICTURES), **problems(403, 404, 410, 412, 416)},
)
async def get_result(result_id: ResultId, services: ServicesDep, access: AccessDep, asked: BytesAskedDep) -> Response:
    """Download a result, whole or in ranges. Its ETag is the sha256 of the content."""
    return await _answer(services, asked, access, await services.calls.read(_find, services, access, result_id))


@open_router.get("/{result_id}/cube", response_class=StreamingResponse, include_in_schema=False)
@open_router.get(
    "/{result_id}/look.cube",
    response_class=StreamingResponse,
    responses={**file_answers("text/plain"), **problems(403, 404, 410, 412, 416)},
)
async def get_result_cube(
    result_id: ResultId, services: ServicesDep, access: AccessDep, asked: BytesAskedDep, person: PersonNumber = 1
) -> Response:
    """Download a look's colours as a 3D LUT of 33 nodes a side, if `output.extras` asked for `cube`."""
    part = await services.calls.read(_find_part, services, access, result_id, "look.cube", person)
    return await _answer(services, asked, access, part)


@open_router.get(
    "/{result_id}/matte",
    response_class=StreamingResponse,
    responses={**file_answers("video/x-matroska", "video/quicktime", "image/png"), **problems(403, 404, 410, 412, 416)},
)
async def get_result_matte(
    result_id: ResultId, services: ServicesDep, access: AccessDep, asked: BytesAskedDep, person: PersonNumber = 1
) -> Response:
    """Download where a look lies, white on black, with the frames of the clip, if `output.extras` asked for `matte`."""
    part = await services.calls.read(_find_part, services, access, result_id, "matte", person)
    return await _answer(services, asked, access, part)


async def _answer(services: Services, asked: BytesAsked, access: Access, kept: _Kept) -> Response:
    result = kept.result
    whose = result.part_of or result.id
    access.count(services, asked.state, result.owner, whose)
    file = File(kept.key, result.sha256, result.size_bytes, result.content_type, result.filename, of=whose)
    # a link is opened by a browser, which would leave faces among its files
    return await send_file(services, asked, file, may_keep=not access.by_link)


def _find(services: Services, access: Access, result_id: str) -> _Kept:
    with services.database.read() as session:
        access.to(services, session, "result", result_id)
        return _kept(session, _result(session, access, result_id), services.database.now())


def _result(session: Session, access: Access, result_id: str) -> Result:
    result = results.get(session, result_id, owner=access.owner)
    if result is None:
        raise NotFoundError(f"there is no result {result_id}")
    access.check_owner(session, result.owner)
    return result


def _find_part(services: Services, access: Access, result_id: str, part: PartName, person: int) -> _Kept:
    with services.database.read() as session:
        access.to(services, session, "result", result_id, part, str(person))
        result = _result(session, access, result_id)
        there = [one for one in results.parts(session, [result.id]) if one.part == part]
        for one in there:
            if one.person == person:
                return _kept(session, one, services.database.now())
    if not there:
        name = {"look.cube": "cube", "matte": "matte"}[part]
        raise NotFoundError(f'{result_id} has no {part}; run the transfer with "output": {{"extras": ["{name}"]}}')
    persons = ", ".join(str(one.person) for one in there)
    raise NotFoundError(f"{result_id} has no {part} of person {person}; it has those of: {persons}")


@router.post(
    "/{result_id}/link",
    responses=problems(400, 404, 409, 410, 413, 415, 507),
    openapi_extra=json_body(ResultLinkRequest, required=False),
)
async def create_result_link(
    request: Request, result_id: ResultId, services: ServicesDep, caller: CallerDep, once: OnceDep
) -> LinkBody:
    """Make a link to a result, or to its cube or matte, that needs no key and expires."""
    if has_body(request):
        wanted = await read_json(request, ResultLinkRequest, limit_bytes=services.settings.max_json_bytes)
    else:
        wanted = ResultLinkRequest()
    async with once:
        once.compare(wanted.model_dump(mode="json"))
        return await services.calls.write(_make_link, services, caller, once, result_id, wanted)


@router.delete("/{result_id}", status_code=204, response_class=Response, responses=problems(404, 412, 507))
async def delete_result(
    result_id: ResultId, services: ServicesDep, caller: CallerDep, if_match: IfMatch = None
) -> None:
    """Delete a result with its cube and matte. Its video, its reference and the record of its job stay."""
    gone = await services.calls.write(_delete, services, caller.owner, result_id, if_match)
    await services.calls.remove(services.blobs.delete, gone)


def _delete(services: Services, owner: str, result_id: str, if_match: str | None) -> list[str]:
    with services.database.write(frees=True) as session:
        result = results.get(session, result_id, owner=owner)
        if result is None:
            raise NotFoundError(f"there is no result {result_id}")
        require_match(if_match, etag_of_file(result.sha256))
        return results.delete(session, result_id, now=services.database.now())


def _make_link(services: Services, caller: Caller, once: Once, result_id: str, wanted: ResultLinkRequest) -> LinkBody:
    access = Access(caller.owner)
    if wanted.part is None:
        found, what, place = _find(services, access, result_id), [result_id], result_id
    else:
        found = _find_part(services, access, result_id, wanted.part, wanted.person)
        what, place = [result_id, wanted.part, str(wanted.person)], f"{result_id}/{wanted.part}"
    now = services.database.now()
    wait = min(timedelta(seconds=wanted.expires_in_s), max(found.until - now, timedelta(seconds=1)))
    expires_at = min(now + wait, found.until).replace(microsecond=0)
    url = services.storage.link(found.key, expires_in=wait) if services.settings.links_to_store else None
    with services.database.write() as session:
        if url is None:
            # the key as it is when the answer is kept: a link of a secret that is replaced meanwhile would be void
            seal = keys.seals(session, found.result.owner, now=now)[0]
            query = services.signer.sign("result", *what, by=found.result.owner, seal=seal, expires_at=expires_at)
            query |= {"person": str(wanted.person)} if wanted.part is not None and wanted.person > 1 else {}
            url = f"{addresses.of_result(services.settings, place)}?{urlencode(query)}"
        body = LinkBody(url=url, expires_at=expires_at)
        once.keep(session, 200, body, location=None, resource_id=result_id)
    return body


def _kept(session: Session, result: Result, now: datetime) -> _Kept:
    """A result or a part of one as it is kept. Raises `GoneError` after its retention, or that of one of its media."""
    until = results.kept_until(session, [result])[result.id]
    if result.blob_key is None or until <= now:
        detail = f"{result.part_of or result.id} has expired; run the transfer again to make it once more, "
        raise GoneError(f"{detail}without its Idempotency-Key or with a new one")
    return _Kept(result, result.blob_key, until)
