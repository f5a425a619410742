"""/videos: a clip, or a still picture, to be recoloured."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response
from starlette.responses import StreamingResponse

from service.api import commands
from service.api.authentication import CallerDep
from service.api.dependencies import (
    UNCHANGED,
    CancelJobs,
    IfMatch,
    IfNoneMatch,
    InputColorOf,
    MaskOf,
    MatchingOf,
    MetadataOf,
    ServicesDep,
    VideoCursor,
    VideoId,
    WebhookOf,
    problems,
)
from service.api.downloads import CLIPS, PICTURES, BytesAskedDep, file_answers
from service.api.idempotency import OnceDep
from service.api.openapi import file_body, form_body, json_body
from service.api.routers import _media
from service.api.schemas import MediaBody, MediaPage, VideoByUrl, VideoOptions
from service.catalog import Role

router = APIRouter(prefix="/videos", tags=["videos"])


@router.post(
    "",
    status_code=202,
    responses=_media.upload_answers(),
    openapi_extra=file_body("A clip, or a still picture, to be recoloured"),
)
async def create_video(
    request: Request,
    response: Response,
    services: ServicesDep,
    caller: CallerDep,
    once: OnceDep,
    mask: MaskOf = None,
    matching: MatchingOf = None,
    input_color: InputColorOf = None,
    metadata: MetadataOf = [],  # noqa: B006 - FastAPI copies it
    webhook: WebhookOf = None,
) -> MediaBody:
    """Upload a clip or a still picture. The same bytes with the same settings get the same id."""
    said: dict[str, str | None] = {"mask": mask, "matching": matching, "input_color": input_color}
    given = _media.Given(VideoOptions, VideoByUrl, said, metadata, webhook)
    return await _media.upload(services, caller, once, Role.VIDEO, request, response, given)


@router.post(
    "/form",
    status_code=202,
    responses=_media.upload_answers(),
    openapi_extra=form_body("The file and its settings as a form", VideoOptions),
)
async def create_video_from_form(
    request: Request, response: Response, services: ServicesDep, caller: CallerDep, once: OnceDep
) -> MediaBody:
    """Upload a clip or a still picture in a form: the field `file` holds it, further fields its settings."""
    given = _media.Given(VideoOptions, VideoByUrl, {})
    return await _media.upload(services, caller, once, Role.VIDEO, request, response, given, only="multipart/form-data")


@router.post(
    "/url",
    status_code=202,
    responses=_media.upload_answers(),
    openapi_extra=json_body(VideoByUrl),
)
async def create_video_from_url(
    request: Request, response: Response, services: ServicesDep, caller: CallerDep, once: OnceDep
) -> MediaBody:
    """Have the service fetch a clip or a still picture from a URL. The answer comes once the file is there."""
    given = _media.Given(VideoOptions, VideoByUrl, {})
    return await _media.upload(services, caller, once, Role.VIDEO, request, response, given, only="application/json")


@router.get("", responses=problems())
async def list_videos(
    services: ServicesDep, caller: CallerDep, asked: _media.PageDep, cursor: VideoCursor = None
) -> MediaPage:
    """List videos, newest first. All given filters must match."""
    return await services.calls.read(_media.page, services, caller, Role.VIDEO, asked, cursor)


@router.get("/{video_id}", response_model=MediaBody, responses=UNCHANGED | problems(404))
async def get_video(
    video_id: VideoId, services: ServicesDep, caller: CallerDep, if_none_match: IfNoneMatch = None
) -> Response:
    """Get a video: its state and, once it is ready, its properties and faces."""
    return await services.calls.read(_media.show, services, caller, Role.VIDEO, video_id, if_none_match)


@router.get(
    "/{video_id}/file",
    response_class=StreamingResponse,
    responses={**file_answers(*CLIPS, "video/x-msvideo", *PICTURES), **problems(404, 410, 412, 416)},
)
async def get_video_file(video_id: VideoId, services: ServicesDep, caller: CallerDep, asked: BytesAskedDep) -> Response:
    """Download the uploaded file, byte for byte, whole or in ranges. Its ETag is the sha256 of the content."""
    return await _media.send(services, caller, Role.VIDEO, video_id, asked)


@router.delete("/{video_id}", status_code=204, response_class=Response, responses=problems(404, 409, 412, 507))
async def delete_video(
    video_id: VideoId,
    services: ServicesDep,
    caller: CallerDep,
    cancel_jobs: CancelJobs = False,
    if_match: IfMatch = None,
) -> None:
    """Delete a video and everything derived from it: landmarks, asset and results."""
    await commands.remove(services, caller.owner, Role.VIDEO, video_id, cancel_jobs=cancel_jobs, if_match=if_match)
