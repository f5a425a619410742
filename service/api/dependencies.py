"""The parameters that routes share, and the documentation of their answers."""

from __future__ import annotations

import re
from typing import Annotated, Any, Final, cast

from fastapi import Depends, Header, Path, Query, Request
from pydantic import AfterValidator, BaseModel

from service.api.schemas import RECEIVER_URL, MetadataPairs, Problem, VideoOptions
from service.api.services import Services
from service.catalog import InputColor, Mask, Matching
from service.errors import PROBLEM_JSON
from service.ids import DELIVERY_CURSOR, JOB_CURSOR, REFERENCE_CURSOR, UPLOAD_CURSOR, VIDEO_CURSOR

#: seconds for which an answer may be held
MAX_WAIT_S: Final = 60
#: entries of a list at once
MAX_PAGE: Final = 200
_SETTINGS: Final = VideoOptions.model_fields


async def get_services(request: Request) -> Services:
    """The parts of the running API."""
    # not a plain function: FastAPI would call that in a thread of its own, for every request
    return cast("Services", request.app.state.services)


ServicesDep = Annotated[Services, Depends(get_services)]


def _without_nul(given: str) -> str:
    return given.replace("\0", "\ufffd")  # PostgreSQL takes no text with a NUL


# an id of a wrong form is just unknown: 404, not 422
_Unknown = AfterValidator(_without_nul)


def _id_of(what: str, prefix: str) -> Any:
    return Path(description=f"id of {what}", examples=[f"{prefix}_0192f0c1a2b37c4d8e5f60718293a4b5"])


def _cursor(pattern: re.Pattern[str]) -> Any:
    return Query(pattern=pattern.pattern, description="`next_cursor` of the page before")


VideoId = Annotated[str, _Unknown, _id_of("a video", "vid")]
ReferenceId = Annotated[str, _Unknown, _id_of("a reference", "ref")]
JobId = Annotated[str, _Unknown, _id_of("a job", "job")]
ResultId = Annotated[str, _Unknown, _id_of("a result", "res")]
DeliveryId = Annotated[str, _Unknown, _id_of("a delivery", "msg")]
UploadId = Annotated[str, _Unknown, _id_of("an upload", "upl")]
PersonNumber = Annotated[
    int,
    Query(
        ge=1,
        le=1000,
        description="number of the person, from 1, if the look changes several; in the order of their faces",
    ),
]
MetadataOf = Annotated[
    MetadataPairs,
    Query(description="`name:value`, repeated for up to 16 names: your own data, returned and never interpreted"),
]
WebhookOf = Annotated[
    str | None,
    Query(
        json_schema_extra={"pattern": RECEIVER_URL, "maxLength": 2048},  # checked by `service.api.receivers`
        description="URL of a receiver that is told when the file is vectorised or has failed",
    ),
]
CancelJobs = Annotated[bool, Query(description="cancel the jobs that need it; without it the answer is 409")]
VideoCursor = Annotated[str | None, _cursor(VIDEO_CURSOR)]
ReferenceCursor = Annotated[str | None, _cursor(REFERENCE_CURSOR)]
JobCursor = Annotated[str | None, _cursor(JOB_CURSOR)]
DeliveryCursor = Annotated[str | None, _cursor(DELIVERY_CURSOR)]
UploadCursor = Annotated[str | None, _cursor(UPLOAD_CURSOR)]
PageSize = Annotated[int, Query(ge=1, le=MAX_PAGE, description="most entries of the page")]
MaskOf = Annotated[Mask | None, Query(description=_SETTINGS["mask"].description)]
MatchingOf = Annotated[Matching | None, Query(description=_SETTINGS["matching"].description)]
InputColorOf = Annotated[InputColor | None, Query(description=_SETTINGS["input_color"].description)]


def all_lines(request: Request, name: str) -> str | None:
    """A header field that is a list, of all its lines (RFC 9110, 5.3), or None without one."""
    lines = request.headers.getlist(name)
    return ", ".join(lines) if lines else None


async def _if_none_match(
    request: Request,
    _: Annotated[
        str | None,
        Header(alias="If-None-Match", description="ETags that the client has; 304 if one of them is still right"),
    ] = None,
) -> str | None:
    return all_lines(request, "if-none-match")


async def _if_match(
    request: Request,
    _: Annotated[
        str | None, Header(alias="If-Match", description="ETags, or `*`; 412 if none of them is still right")
    ] = None,
) -> str | None:
    return all_lines(request, "if-match")


IfNoneMatch = Annotated[str | None, Depends(_if_none_match)]
IfMatch = Annotated[str | None, Depends(_if_match)]
WaitSeconds = Annotated[
    float | None,
    Query(ge=0, le=MAX_WAIT_S, description="seconds to wait for the end of the job; also as `Prefer: wait=`"),
]


Responses = dict[int | str, dict[str, Any]]
UNCHANGED: Responses = {304: {"description": "unchanged since the ETag in If-None-Match"}}


def answer(status: int, model: type[BaseModel], description: str) -> Responses:
    """The documentation of another answer that is no error."""
    return {status: {"model": model, "description": description}}


def problems(*statuses: int) -> Responses:
    """The documentation of the error answers of an endpoint."""
    content = {PROBLEM_JSON: {"schema": {"$ref": f"#/components/schemas/{Problem.__name__}"}}}
    # one for each: the schema is completed in place
    return {status: {"description": "", "content": dict(content)} for status in (401, *statuses, 422, 429, 503)}
