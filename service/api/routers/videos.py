"""/videos: a clip, or a still picture, to be recoloured."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from service.api import commands
from service.api.dependencies import (
    CancelJobs,
    Cursor,
    MaskOf,
    MatchingOf,
    PageSize,
    ServicesDep,
    VideoId,
    answer,
    problems,
)
from service.api.openapi import file_body
from service.api.routers import _media
from service.api.schemas import MediaBody, MediaPage, VideoOptions
from service.catalog import Role

router = APIRouter(prefix="/videos", tags=["videos"])


@router.post(
    "",
    status_code=202,
    responses=answer(200, MediaBody, "the same content is there already") | problems(400, 413, 415, 507),
    openapi_extra=file_body("A clip, or a still picture, to be recoloured", VideoOptions),
)
async def upload_video(
    request: Request, response: Response, services: ServicesDep, mask: MaskOf = None, matching: MatchingOf = None
) -> MediaBody:
    """Upload a video; it is vectorised once, and the same bytes with the same settings answer with the same id."""
    given = _media.Given(VideoOptions, {"mask": mask, "matching": matching})
    return await _media.upload(services, Role.VIDEO, request, response, given)


@router.get("", responses=problems())
def list_videos(services: ServicesDep, cursor: Cursor = None, limit: PageSize = 50) -> MediaPage:
    """All videos, newest first."""
    return _media.page(services, Role.VIDEO, cursor, limit)


@router.get("/{video_id}", responses=problems(404))
def show_video(video_id: VideoId, services: ServicesDep) -> MediaBody:
    """One video: its state, and what was found in it once it is ready."""
    return _media.show(services, Role.VIDEO, video_id)


@router.delete("/{video_id}", status_code=204, responses=problems(404, 409, 507))
def delete_video(video_id: VideoId, services: ServicesDep, cancel_jobs: CancelJobs = False) -> None:
    """Delete the video with everything derived from it: landmarks, asset and results."""
    commands.remove(services, Role.VIDEO, video_id, cancel_jobs=cancel_jobs)
