"""/transfer and /swap: jobs that make recoloured clips. Neither ever vectorises."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final, TypeVar

from fastapi import APIRouter, Request, Response
from pydantic import ValidationError

from service import addresses
from service.api import commands
from service.api.authentication import Caller, CallerDep
from service.api.commands import Asked, WantedLook, WantedOutput
from service.api.dependencies import ServicesDep, answer, problems
from service.api.idempotency import Once, OnceDep
from service.api.json_body import media_type, read_json, unsupported
from service.api.multipart import Form, TooManyFilesError, read_form
from service.api.openapi import TRANSFER_FORM, form, json_body
from service.api.problems import invalid_values
from service.api.receivers import receiver
from service.api.schemas import USUAL_CONTAINERS, JobBody, MediaBody, SwapRequest, TransferRequest
from service.api.services import Services
from service.api.transfer_form import reference_at, references_of, to_request, wrong_file
from service.api.uploads import Intake
from service.catalog import JobKind, Role
from service.errors import Limit, ValidationFailedError

router = APIRouter(tags=["transfer"])

#: stands for the id of a reference file that is not recorded yet
_UPLOADED = f"ref_{'0' * 32}"

_FORM: Final = "multipart/form-data"

Model = TypeVar("Model", TransferRequest, SwapRequest)


@router.post(
    "/transfer",
    status_code=202,
    responses=answer(200, JobBody, "the same was asked for before") | problems(400, 404, 409, 413, 415, 507),
    openapi_extra=json_body(TransferRequest),
)
async def create_transfer(
    request: Request, response: Response, services: ServicesDep, caller: CallerDep, once: OnceDep
) -> JobBody:
    """Give a video the colours of one or more references: one look each, all in one job.

    The job waits for media that are still being vectorised.
    """
    is_form = media_type(request) == _FORM
    brought: dict[str, MediaBody] = {}
    async with once:
        try:
            if is_form:
                wanted = await _read_form(request, services, caller, once, brought)
            else:
                wanted = await _read(request, services, TransferRequest, once)
            looks, places = _looks_of(wanted, services, is_form=is_form)
            webhook = receiver(services, wanted.webhook, "/webhook" if is_form else "/webhook/url")
            asked = _asked_by(caller, once, wanted, webhook)
            output = WantedOutput(wanted.output, "" if is_form else "/output")
            return await _accept(services, response, JobKind.TRANSFER, looks, output, places, asked)
        except Exception:
            await commands.take_back(services, caller.owner, list(brought.values()))
            raise


@router.post(
    "/transfer/form",
    status_code=202,
    responses=answer(200, JobBody, "the same was asked for before") | problems(400, 404, 409, 413, 415, 507),
    openapi_extra=form(TRANSFER_FORM),
)
async def create_transfer_from_form(
    request: Request, response: Response, services: ServicesDep, caller: CallerDep, once: OnceDep
) -> JobBody:
    """Make a transfer from a form, with references as files or ids. Its options apply to all looks."""
    if media_type(request) != _FORM:
        raise unsupported(request, _FORM)
    return await create_transfer(request, response, services, caller, once)


@router.post(
    "/swap",
    status_code=202,
    responses=answer(200, JobBody, "the same was asked for before") | problems(400, 404, 409, 413, 415, 507),
    openapi_extra=json_body(SwapRequest),
)
async def create_swap(
    request: Request, response: Response, services: ServicesDep, caller: CallerDep, once: OnceDep
) -> JobBody:
    """Exchange the colours of two videos, or of two faces in one.

    With two videos, the first result is `a` with the colours of `b`, and the second is `b` with the colours of `a`.
    Without `b`, two `faces` of `a` exchange their colours in one result.
    """
    async with once:
        wanted = await _read(request, services, SwapRequest, once)
        looks = _sides_of(wanted)
        places = {"/a": wanted.a} | ({} if wanted.b is None else {"/b": wanted.b})
        asked = _asked_by(caller, once, wanted, receiver(services, wanted.webhook))
        output = WantedOutput(wanted.output, "/output")
        return await _accept(services, response, JobKind.SWAP, looks, output, places, asked)


def _asked_by(caller: Caller, once: Once, wanted: TransferRequest | SwapRequest, webhook: str | None) -> Asked:
    return Asked(caller.owner, once, metadata=wanted.metadata, webhook=webhook, force=wanted.force)


async def _accept(
    services: Services,
    response: Response,
    kind: JobKind,
    looks: list[WantedLook],
    output: WantedOutput,
    places: dict[str, str],
    asked: Asked,
) -> JobBody:
    lost = await commands.find_lost(services, kind, looks, output, asked)
    body, new = await services.calls.write(
        commands.request_looks, services, kind, looks, output, places, asked, lost=lost
    )
    response.status_code = 202 if new else 200
    response.headers["Location"] = addresses.of_job(services.settings, body.id)
    return body


def _sides_of(wanted: SwapRequest) -> list[WantedLook]:
    """The looks of a swap. Raises `ValidationFailedError` for a video and itself without two faces to exchange."""
    a, b, faces = wanted.a, wanted.b, wanted.faces
    ours, theirs = wanted.contrasts
    if b is not None and b != a:
        return [WantedLook(a, b, wanted.side(ours), ""), WantedLook(b, a, wanted.side(theirs), "")]
    if faces == "all" or len(faces) != 2 or faces[0] == faces[1]:
        raise invalid_values({"/faces": "a swap within one clip is of two different faces, such as [0, 1]"})
    if wanted.reference_face is not None:
        raise invalid_values(
            {"/reference_face": "within one clip the two faces are each other's reference; leave this out"}
        )
    return [WantedLook(a, a, wanted.side("auto"), "", exchange=(ours, theirs))]


def _looks_of(wanted: TransferRequest, services: Services, *, is_form: bool) -> tuple[list[WantedLook], dict[str, str]]:
    """The looks, if not too many, and the ids by where in the request they stand: a form's options stand at its top."""
    if len(wanted.looks) > services.settings.max_looks:
        raise _too_many_looks(services.settings.max_looks, "/reference" if is_form else "/looks")
    places, looks = {"/video": wanted.video}, []
    for i, look in enumerate(wanted.looks):
        places[reference_at(i) if is_form else f"/looks/{i}/reference"] = look.reference
        looks.append(WantedLook(wanted.video, look.reference, look, "" if is_form else f"/looks/{i}"))
    return looks, places


def _too_many_looks(most: int, where: str) -> ValidationFailedError:
    return ValidationFailedError.at(where, f"a transfer has at most {most} looks", limit=Limit(most, "looks"))


@contextmanager
def _counted(most: int) -> Iterator[None]:
    """Inside the block a request of more looks than are read is refused as one of more than are allowed."""
    try:
        yield
    except ValidationFailedError as error:
        found = error.__cause__.errors(include_input=False) if isinstance(error.__cause__, ValidationError) else []
        if any((one["type"], one["loc"]) == ("too_long", ("looks",)) for one in found):
            raise _too_many_looks(most, "/looks") from error
        raise


async def _read(request: Request, services: Services, model: type[Model], once: Once) -> Model:
    also = (_FORM,) if model is TransferRequest else ()
    with _counted(services.settings.max_looks):
        wanted = await read_json(request, model, limit_bytes=services.settings.max_json_bytes, also=also)
    once.compare(_as_compared(wanted))
    return wanted


def _as_compared(wanted: TransferRequest | SwapRequest) -> dict[str, Any]:
    """What a request asks for, as repeated requests are compared by: the same for two that ask for the same."""
    asked = wanted.model_dump(mode="json")
    if asked["output"]["container"] in USUAL_CONTAINERS:
        asked["output"]["container"] = None  # of the video's kind it is the default, of the other it is refused
    return asked


def _form_as_compared(draft: TransferRequest, form: Form) -> dict[str, Any]:
    """`_as_compared` of a form, whose files are what they hold and what they are called."""
    asked = _as_compared(draft)
    for look, part in zip(asked["looks"], references_of(form), strict=True):
        if not isinstance(part, str):
            look["reference"] = [part.filename, part.sha256]
    return asked


async def _read_form(
    request: Request, services: Services, caller: Caller, once: Once, brought: dict[str, MediaBody]
) -> TransferRequest:
    """The one-line client's form: `video`, one or more `reference` files or ids, and options for all of them.

    References that are recorded and new are added to ``brought``, by id.
    """
    settings = services.settings
    limit_bytes = settings.max_upload_bytes
    async with (
        services.arriving.place(caller.owner, free="again" if once.answered else None) as share,
        Intake(services.storage.spool, services.room, request, limit_bytes=limit_bytes, share=share) as intake,
    ):
        try:
            form = await read_form(intake, max_files=settings.max_looks, wrong_file=wrong_file)
        except TooManyFilesError as error:
            raise _too_many_looks(settings.max_looks, "/reference") from error
        draft = to_request(form, [_UPLOADED] * len(form.files))
        once.compare(_form_as_compared(draft, form))
        # everything is checked before the first reference is recorded
        looks, places = _looks_of(draft, services, is_form=True)
        places = {where: one for where, one in places.items() if one != _UPLOADED or where == "/video"}
        receiver(services, draft.webhook, "/webhook")
        output = WantedOutput(draft.output, "")
        await services.calls.read(commands.check_looks, services, caller.owner, looks, output, places)
        asked = Asked(caller.owner, once)
        ids = []
        for _, file in form.files:
            found = await commands.register(services, Role.REFERENCE, file, asked=asked, answers=False)
            share.give_back(file.size_bytes)
            ids.append(found.body.id)
            if found.new or found.body.id in brought:
                brought[found.body.id] = found.body
    return to_request(form, ids) if ids else draft
