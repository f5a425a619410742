"""/preview: one frame or crop of one look, while somebody waits."""

from __future__ import annotations

from contextlib import suppress

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel

from service.api import commands
from service.api.absences import no_face, no_frame
from service.api.authentication import CallerDep
from service.api.commands import WantedLook, stills
from service.api.dependencies import UNCHANGED, IfNoneMatch, Responses, ServicesDep, problems
from service.api.idempotency import OnceDep, Replay
from service.api.json_body import read_json
from service.api.openapi import file_content, json_body
from service.api.preview_request import PreviewRequest
from service.api.problems import invalid_values
from service.api.services import Services
from service.catalog import Media, StillRequest, media

router = APIRouter(tags=["preview"])

_PICTURE: Responses = {
    200: {
        "description": "the picture",
        "content": file_content("image/jpeg", "image/png"),
    }
}


class _Shown(BaseModel):
    """What is kept of an answer for an Idempotency-Key: it is made again, and the same."""


@router.post(
    "/preview",
    response_class=Response,
    responses={**_PICTURE, **UNCHANGED, **problems(400, 404, 409, 413, 415, 507)},
    openapi_extra=json_body(PreviewRequest),
)
async def create_preview(
    request: Request, services: ServicesDep, caller: CallerDep, once: OnceDep, if_none_match: IfNoneMatch = None
) -> Response:
    """Draw one frame of a video with one look, while the client waits, as for a slider. It is not a result."""
    async with once:
        wanted = await read_json(request, PreviewRequest, limit_bytes=services.settings.max_json_bytes)
        with suppress(Replay):  # it changes nothing, so it is done again
            once.compare(wanted.model_dump(mode="json"))
        asked = await services.calls.read(_check, services, caller.owner, wanted)
        answer = await stills.picture(services, caller.owner, asked, if_none_match=if_none_match)
        if not once.answered:
            await services.calls.write(_keep, services, once, wanted.video)
    return answer


def _keep(services: Services, once: OnceDep, video_id: str) -> None:
    if once.is_named:
        with services.database.write() as session:
            once.keep(session, 200, _Shown(), location=None, resource_id=video_id)


def _check(services: Services, owner: str, wanted: PreviewRequest) -> stills.WantedStill:
    """What is to be drawn.

    Raises what `commands.check_usable` and `stills.check_ready` do, and `ValidationFailedError` for what does not fit.
    """
    look = wanted.look
    places = {"/video": wanted.video} | ({} if look is None else {"/look/reference": look.reference})
    with services.database.read() as session:
        known = media.several(session, owner, {*places.values()})
    commands.check_usable(known, places)
    video = known[wanted.video]
    # nothing that is waited for would change that
    commands.check_role(video, "/video")
    for media_id in places.values():
        stills.check_ready(known[media_id])
    if errors := _misfits(video, wanted):
        raise invalid_values(errors)
    params = None
    if look is not None:
        one = WantedLook(wanted.video, look.reference, look, "/look")
        commands.check_look(video, known[look.reference], one, "/video")
        params = commands.params_of(one)
    request = StillRequest(
        format=wanted.format,
        max_width=wanted.max_width,
        frame=wanted.frame,
        time_s=wanted.time_s,
        nearest=wanted.nearest,
        params=params,
        before=wanted.before,
        crop=wanted.crop,
        face=wanted.face,
    )
    pointers = {media_id: where for where, media_id in reversed(places.items())}
    return stills.WantedStill(wanted.video, None if look is None else look.reference, request, pointers)


def _misfits(video: Media, wanted: PreviewRequest) -> dict[str, str]:
    """What of a request is not in the video, by JSON pointer."""
    info, errors = video.info or {}, {}
    count = stills.frame_count(video)
    if wanted.frame is not None and wanted.frame >= count:
        errors["/frame"] = no_frame(video, count)
    duration_s = float(info.get("duration_s", 0.0))
    if wanted.time_s is not None and wanted.time_s > duration_s:
        errors["/time_s"] = f"{video.id} ends after {duration_s:.3f} s"
    if wanted.face is not None and wanted.face >= len(video.faces):
        errors["/face"] = no_face(video, wanted.face)
    if wanted.crop is not None and info:
        x, y, _, _ = wanted.crop
        if x >= info["width"] or y >= info["height"]:
            errors["/crop"] = f"the picture is {info['width']}x{info['height']}"
    return errors
