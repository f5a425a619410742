"""The parameters that routes share, and the documentation of their answers."""

from __future__ import annotations

from typing import Annotated, Any, Final, cast

from fastapi import Depends, Header, Path, Query, Request
from pydantic import AfterValidator, BaseModel

from service.api.schemas import RECEIVER_URL, MetadataPairs, Problem
from service.api.services import Services
from service.catalog import InputColor, Mask, Matching
from service.errors import PROBLEM_JSON
from service.ids import DELIVERY_CURSOR, JOB_CURSOR, MEDIA_ID, UPLOAD_CURSOR

#: seconds for which an answer may be held
MAX_WAIT_S: Final = 60
#: entries of a list at once
MAX_PAGE: Final = 200


async def get_services(request: Request) -> Services:
    """The parts of the running API."""
    # not a plain function: FastAPI would call that in a thread of its own, for every request
    return cast("Services", request.app.state.services)


ServicesDep = Annotated[Services, Depends(get_services)]


def _without_nul(given: str) -> str:
    return given.replace("\0", "\ufffd")  # PostgreSQL takes no text with a NUL


# an id of a wrong form is just unknown: 404, not 422
_Unknown = AfterValidator(_without_nul)
VideoId = Annotated[str, _Unknown, Path(examples=["vid_0192f0c1a2b37c4d8e5f60718293a4b5"])]
ReferenceId = Annotated[str, _Unknown, Path(examples=["ref_0192f0c1a2b37c4d8e5f60718293a4b5"])]
JobId = Annotated[str, _Unknown, Path(examples=["job_0192f0c1a2b37c4d8e5f60718293a4b5"])]
ResultId = Annotated[str, _Unknown, Path(examples=["res_0192f0c1a2b37c4d8e5f60718293a4b5"])]
DeliveryId = Annotated[str, _Unknown, Path(examples=["msg_0192f0c1a2b37c4d8e5f60718293a4b5"])]
UploadId = Annotated[str, _Unknown, Path(examples=["upl_0192f0c1a2b37c4d8e5f60718293a4b5"])]
PersonNumber = Annotated[
    int, Query(ge=1, le=1000, description="which of the persons that the look changes, by their faces' indices")
]
MetadataOf = Annotated[
    MetadataPairs, Query(description="`name:value`, up to 16 of them: names and values of your own, shown back")
]
WebhookOf = Annotated[
    str | None,
    Query(pattern=RECEIVER_URL, max_length=2048, description="URL of who is told when it is vectorised, or has failed"),
]
CancelJobs = Annotated[bool, Query(description="cancel the jobs that use it instead of answering 409")]
Cursor = Annotated[str | None, Query(pattern=MEDIA_ID.pattern, description="`next_cursor` of the page before")]
JobCursor = Annotated[str | None, Query(pattern=JOB_CURSOR.pattern, description="`next_cursor` of the page before")]
DeliveryCursor = Annotated[
    str | None, Query(pattern=DELIVERY_CURSOR.pattern, description="`next_cursor` of the page before")
]
UploadCursor = Annotated[
    str | None, Query(pattern=UPLOAD_CURSOR.pattern, description="`next_cursor` of the page before")
]
PageSize = Annotated[int, Query(ge=1, le=MAX_PAGE)]
MaskOf = Annotated[Mask | None, Query(description="how the skin is found: landmarks, or ycbcr, the paper's rule")]
MatchingOf = Annotated[
    Matching | None, Query(description="how colours are carried: table, or chain, the paper's way with its resets")
]
InputColorOf = Annotated[
    InputColor | None,
    Query(description="how the file is coded: auto believes its tags, logarithms of cameras must be named"),
]
IfNoneMatch = Annotated[str | None, Header(description="ETags that the client has: 304 when one is the answer's")]
IfMatch = Annotated[str | None, Header(description="ETags, or `*`: 412 when none is that of what is there")]
WaitSeconds = Annotated[
    float | None, Query(ge=0, le=MAX_WAIT_S, description="hold the answer until the job is done; or `Prefer: wait=`")
]


Responses = dict[int | str, dict[str, Any]]
UNCHANGED: Responses = {304: {"description": "unchanged: its ETag is in If-None-Match"}}


def answer(status: int, model: type[BaseModel], description: str) -> Responses:
    """The documentation of another answer that is no error."""
    return {status: {"model": model, "description": description}}


def problems(*statuses: int) -> Responses:
    """The documentation of the error answers of an endpoint."""
    content = {PROBLEM_JSON: {"schema": {"$ref": f"#/components/schemas/{Problem.__name__}"}}}
    # one for each: the schema is completed in place
    return {status: {"description": "", "content": dict(content)} for status in (401, *statuses, 422, 429, 503)}
