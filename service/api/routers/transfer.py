"""/transfer and /swap: jobs that make recoloured clips. Neither ever vectorises."""

from __future__ import annotations

from typing import Any, TypeVar

from fastapi import APIRouter, Request, Response
from pydantic import ValidationError
from starlette.concurrency import run_in_threadpool

from service.api import commands
from service.api.commands import Wanted
from service.api.dependencies import ServicesDep, problems
from service.api.multipart import Form, read_form
from service.api.openapi import TRANSFER_FORM, json_body
from service.api.problems import invalid, invalid_values
from service.api.routers.jobs import load_job
from service.api.schemas import JobBody, LookOptions, OutputRequest, SwapRequest, TransferRequest
from service.api.services import Services
from service.api.uploads import Intake
from service.catalog import JobKind, Role
from service.errors import ServiceError, TooLargeError, UnsupportedMediaError, ValidationFailedError

router = APIRouter(tags=["transfer"])

_OUTPUT_FIELDS = frozenset(OutputRequest.model_fields)
_LOOK_FIELDS = frozenset(LookOptions.model_fields)
_LISTS = frozenset({"protect", "faces"})
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
    """Exchange the colours of two videos: the first result is `a` with the colours of `b`, the second the other."""
    wanted = await _read(request, services, SwapRequest)
    job = await run_in_threadpool(
        commands.request_looks,
        services,
        JobKind.SWAP,
        [Wanted(wanted.a, wanted.b, wanted, "/faces"), Wanted(wanted.b, wanted.a, wanted, "/faces")],
        wanted.output,
        {wanted.a: "/a", wanted.b: "/b"},
    )
    return await _accepted(services, job.id, response)


def _looks_of(wanted: TransferRequest, services: Services, *, is_form: bool) -> tuple[list[Wanted], dict[str, str]]:
    """The looks, if not too many, and where in the request each id stands: a form's options stand at its top."""
    if len(wanted.looks) > services.settings.max_looks:
        detail = f"a transfer has at most {services.settings.max_looks} looks"
        raise ValidationFailedError(detail, errors=[{"pointer": "/looks", "detail": detail}])
    places = ["" if is_form else f"/looks/{i}" for i in range(len(wanted.looks))]
    pairs = list(zip(wanted.looks, places, strict=True))
    pointers = {look.reference: f"{place}/reference" for look, place in pairs} | {wanted.video: "/video"}
    return [Wanted(wanted.video, look.reference, look, f"{place}/faces") for look, place in pairs], pointers


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
        draft = _from_form(form, [_UPLOADED] * len(form.files))
        looks, pointers = _looks_of(draft, services, is_form=True)
        pointers = {one: place for one, place in pointers.items() if one != _UPLOADED or place == "/video"}
        await run_in_threadpool(commands.check_looks, services, looks, draft.output, pointers)
        ids = []
        for _, file in form.files:
            found, _ = await run_in_threadpool(commands.register, services, Role.REFERENCE, file)
            ids.append(found.id)
    return _from_form(form, ids) if ids else draft


def _from_form(form: Form, uploaded: list[str]) -> TransferRequest:
    options: dict[str, Any] = {}
    output: dict[str, Any] = {}
    references = list(uploaded)
    top: dict[str, Any] = {}
    unknown = [name for name, _ in form.files if name != "reference"]
    names = [name for name, _ in form.fields if name != "reference"]
    if twice := {name for name in names if names.count(name) > 1}:
        raise invalid_values({f"/{name}": "the field is given more than once" for name in sorted(twice)})
    for name, text in form.fields:
        if name == "reference":
            references.append(text)
        elif name == "video":
            top["video"] = text
        elif name in _LOOK_FIELDS:
            split = name in _LISTS and text != "all"
            options[name] = [part.strip() for part in text.split(",") if part.strip()] if split else text
        elif name in _OUTPUT_FIELDS:
            output[name] = text
        else:
            unknown.append(name)
    if unknown:
        raise invalid_values({f"/{name}": "there is no such field here" for name in unknown})
    try:
        return TransferRequest.model_validate(
            {**top, "looks": [{"reference": one, **options} for one in references], "output": output}
        )
    except ValidationError as error:
        raise _of_form(error) from error


def _of_form(error: ValidationError) -> ServiceError:
    """The same problem, with the fields named as the form names them."""
    named: dict[str, str] = {}
    for item in invalid(error).errors:
        parts = item["pointer"].split("/")[1:]
        # /looks/0/strength -> /strength, /output/crf -> /crf
        shown = parts[2:] if parts[0] == "looks" else parts[1:] if parts[0] == "output" else parts
        named.setdefault("/" + ("/".join(shown) or "reference"), item["detail"])
    return invalid_values(named)
