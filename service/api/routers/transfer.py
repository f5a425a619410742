"""/transfer and /swap: jobs that make recoloured clips. Neither ever vectorises."""

from __future__ import annotations

from typing import TypeVar

from fastapi import APIRouter, Request, Response
from pydantic import ValidationError
from starlette.concurrency import run_in_threadpool

from service.api import commands
from service.api.commands import Wanted
from service.api.dependencies import ServicesDep, problems
from service.api.multipart import read_form
from service.api.openapi import TRANSFER_FORM, json_body
from service.api.problems import invalid, invalid_values
from service.api.routers.jobs import load_job
from service.api.schemas import JobBody, SwapRequest, TransferRequest
from service.api.services import Services
from service.api.transfer_form import to_request
from service.api.uploads import Intake
from service.catalog import JobKind, Role
from service.errors import TooLargeError, UnsupportedMediaError, ValidationFailedError

router = APIRouter(tags=["transfer"])

#: stands for the id of a reference file that is not recorded yet
_UPLOADED = f"ref_{'0' * 32}"

Model = TypeVar("Model", TransferRequest, SwapRequest)


@router.post(
    "/transfer",
    status_code=202,
    responses=problems(400, 404, 413, 415, 507),
    openapi_extra=json_body(TransferRequest, TRANSFER_FORM),
)
async def transfer(request: Request, response: Response, services: ServicesDep) -> JobBody:
    """Put the colours of one or more references on a video; media that still vectorise are waited for."""
    is_form = _media_type(request) == "multipart/form-data"
    wanted = await (_read_form(request, services) if is_form else _read(request, services, TransferRequest))
    looks, pointers = _looks_of(wanted, services, is_form=is_form)
    job = await run_in_threadpool(commands.request_looks, services, JobKind.TRANSFER, looks, wanted.output, pointers)
    return await _accepted(services, job.id, response)


@router.post(
    "/swap",
    status_code=202,
    responses=problems(400, 404, 413, 415, 507),
    openapi_extra=json_body(SwapRequest),
)
async def swap(request: Request, response: Response, services: ServicesDep) -> JobBody:
    """Exchange the colours of two videos, or of two faces in one.

    Two videos: the first result is `a` with the colours of `b`, the second the other. Without `b`, two `faces` of `a`
    exchange their colours in one result.
    """
    wanted = await _read(request, services, SwapRequest)
    looks = _sides_of(wanted)
    pointers = {wanted.a: "/a"} if wanted.b in {None, wanted.a} else {wanted.a: "/a", str(wanted.b): "/b"}
    job = await run_in_threadpool(commands.request_looks, services, JobKind.SWAP, looks, wanted.output, pointers)
    return await _accepted(services, job.id, response)


def _sides_of(wanted: SwapRequest) -> list[Wanted]:
    """The looks of a swap. Raises `ValidationFailedError` for a video and itself without two faces to exchange."""
    a, b, faces = wanted.a, wanted.b, wanted.faces
    ours, theirs = wanted.contrasts
    if b is not None and b != a:
        return [Wanted(a, b, wanted.side(ours), ""), Wanted(b, a, wanted.side(theirs), "")]
    if faces == "all" or len(faces) != 2 or faces[0] == faces[1]:
        raise invalid_values({"/faces": "a swap within one clip is of two different faces, such as [0, 1]"})
    if wanted.reference_face is not None:
        raise invalid_values({"/reference_face": "the two faces are each other's reference"})
    return [Wanted(a, a, wanted.side("auto"), "", exchange=(ours, theirs))]


def _looks_of(wanted: TransferRequest, services: Services, *, is_form: bool) -> tuple[list[Wanted], dict[str, str]]:
    """The looks, if not too many, and where in the request each id stands: a form's options stand at its top."""
    if len(wanted.looks) > services.settings.max_looks:
        detail = f"a transfer has at most {services.settings.max_looks} looks"
        raise ValidationFailedError(detail, errors=[{"pointer": "/looks", "detail": detail}])
    places = ["" if is_form else f"/looks/{i}" for i in range(len(wanted.looks))]
    pairs = list(zip(wanted.looks, places, strict=True))
    pointers = {look.reference: f"{place}/reference" for look, place in pairs} | {wanted.video: "/video"}
    return [Wanted(wanted.video, look.reference, look, place) for look, place in pairs], pointers


async def _accepted(services: Services, job_id: str, response: Response) -> JobBody:
    response.headers["Location"] = f"{services.settings.root_path}/jobs/{job_id}"
    return await run_in_threadpool(load_job, services, job_id)


def _media_type(request: Request) -> str:
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()


async def _body(request: Request, *, limit_bytes: int) -> bytes:
    body = bytearray()
    async for chunk in request.stream():
        body += chunk
        if len(body) > limit_bytes:
            raise TooLargeError(f"the body is larger than {limit_bytes} bytes")
    return bytes(body)


async def _read(request: Request, services: Services, model: type[Model]) -> Model:
    if _media_type(request) != "application/json":
        raise UnsupportedMediaError("send the request as application/json")
    body = await _body(request, limit_bytes=services.settings.max_json_bytes)
    try:
        # JSON has numbers and booleans of its own: a text or a boolean is no number there
        return model.model_validate_json(body, strict=True)
    except ValidationError as error:
        raise invalid(error) from error


async def _read_form(request: Request, services: Services) -> TransferRequest:
    """The one-line client's form: `video`, one or more `reference` files or ids, and options for all of them."""
    settings = services.settings
    async with Intake(services.storage, request, limit_bytes=settings.max_upload_bytes) as intake:
        form = await read_form(intake, max_files=settings.max_looks)
        # everything is checked before the first reference is recorded
        draft = to_request(form, [_UPLOADED] * len(form.files))
        looks, pointers = _looks_of(draft, services, is_form=True)
        pointers = {one: place for one, place in pointers.items() if one != _UPLOADED or place == "/video"}
        await run_in_threadpool(commands.check_looks, services, looks, draft.output, pointers)
        ids = []
        for _, file in form.files:
            found, _ = await run_in_threadpool(commands.register, services, Role.REFERENCE, file)
            ids.append(found.id)
    return to_request(form, ids) if ids else draft
