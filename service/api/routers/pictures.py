"""Single pictures of a medium: layers of its frames, its poster, thumbnails of its faces."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path, Query, Response

from service.api.authentication import CallerDep
from service.api.commands import stills
from service.api.dependencies import (
    UNCHANGED,
    IfNoneMatch,
    ReferenceId,
    Responses,
    ServicesDep,
    VideoId,
    problems,
)
from service.api.openapi import file_content
from service.api.preview_request import MAX_WIDTH
from service.catalog import Layer, Role, StillRequest

router = APIRouter()

FrameNumber = Annotated[int, Path(ge=0, le=2**31 - 1, description="number of the frame, from 0, in display order")]
FaceIndex = Annotated[int, Path(ge=0, le=2**31 - 1, description="`index` of the face in `faces` of the medium")]
LayerOf = Annotated[
    Layer, Query(description="`image`: the frame itself; the others: what was found in it, see docs/api.md")
]


def _picture(kind: str) -> Responses:
    whole = {"description": "the picture", "content": file_content(kind)}
    return {200: whole, **UNCHANGED, **problems(404, 409, 507)}


@router.get(
    "/videos/{video_id}/frames/{number}", tags=["videos"], response_class=Response, responses=_picture("image/png")
)
async def get_video_frame(
    video_id: VideoId,
    number: FrameNumber,
    services: ServicesDep,
    caller: CallerDep,
    layer: LayerOf = "image",
    if_none_match: IfNoneMatch = None,
) -> Response:
    """Get a frame of a video, or a layer of what was found in it."""
    request = StillRequest("png", MAX_WIDTH, frame=number, layer=layer)
    return await stills.layer(services, caller.owner, Role.VIDEO, video_id, request, if_none_match=if_none_match)


@router.get(
    "/references/{reference_id}/frames/{number}",
    tags=["references"],
    response_class=Response,
    responses=_picture("image/png"),
)
async def get_reference_frame(
    reference_id: ReferenceId,
    number: FrameNumber,
    services: ServicesDep,
    caller: CallerDep,
    layer: LayerOf = "image",
    if_none_match: IfNoneMatch = None,
) -> Response:
    """Get a frame of a reference, or a layer of it. In a clip, the face is known in its best frame only."""
    request = StillRequest("png", MAX_WIDTH, frame=number, layer=layer)
    return await stills.layer(
        services, caller.owner, Role.REFERENCE, reference_id, request, if_none_match=if_none_match
    )


@router.get("/videos/{video_id}/poster", tags=["videos"], response_class=Response, responses=_picture("image/jpeg"))
async def get_video_poster(
    video_id: VideoId, services: ServicesDep, caller: CallerDep, if_none_match: IfNoneMatch = None
) -> Response:
    """Get a frame that shows the largest face. Its longer side is 640 px at most."""
    return await stills.small_picture(services, caller.owner, Role.VIDEO, video_id, None, if_none_match=if_none_match)


@router.get(
    "/references/{reference_id}/poster", tags=["references"], response_class=Response, responses=_picture("image/jpeg")
)
async def get_reference_poster(
    reference_id: ReferenceId, services: ServicesDep, caller: CallerDep, if_none_match: IfNoneMatch = None
) -> Response:
    """Get a frame that shows the largest face. Its longer side is 640 px at most."""
    return await stills.small_picture(
        services, caller.owner, Role.REFERENCE, reference_id, None, if_none_match=if_none_match
    )


@router.get(
    "/videos/{video_id}/faces/{face}/thumbnail",
    tags=["videos"],
    response_class=Response,
    responses=_picture("image/jpeg"),
)
async def get_video_face_thumbnail(
    video_id: VideoId, face: FaceIndex, services: ServicesDep, caller: CallerDep, if_none_match: IfNoneMatch = None
) -> Response:
    """Get a picture of one face, a square of 160 px."""
    return await stills.small_picture(services, caller.owner, Role.VIDEO, video_id, face, if_none_match=if_none_match)


@router.get(
    "/references/{reference_id}/faces/{face}/thumbnail",
    tags=["references"],
    response_class=Response,
    responses=_picture("image/jpeg"),
)
async def get_reference_face_thumbnail(
    reference_id: ReferenceId,
    face: FaceIndex,
    services: ServicesDep,
    caller: CallerDep,
    if_none_match: IfNoneMatch = None,
) -> Response:
    """Get a picture of one face, a square of 160 px."""
    return await stills.small_picture(
        services, caller.owner, Role.REFERENCE, reference_id, face, if_none_match=if_none_match
    )
