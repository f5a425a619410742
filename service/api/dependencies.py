"""The parameters that routes share, and the documentation of their answers."""

from __future__ import annotations

from typing import Annotated, Any, cast

from fastapi import Depends, Path, Query, Request
from pydantic import AfterValidator, BaseModel

from service.api.schemas import Problem
from service.api.services import Services
from service.catalog import Mask, Matching
from service.ids import MEDIA_ID


def get_services(request: Request) -> Services:
    """The parts of the running API."""
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
CancelJobs = Annotated[bool, Query(description="cancel the jobs that use it instead of answering 409")]
Cursor = Annotated[str | None, Query(pattern=MEDIA_ID.pattern, description="`next_cursor` of the page before")]
PageSize = Annotated[int, Query(ge=1, le=200)]
MaskOf = Annotated[Mask | None, Query(description="how the skin is found: landmarks, or ycbcr, the paper's rule")]
MatchingOf = Annotated[
    Matching | None, Query(description="how colours are carried: table, or chain, the paper's way with its resets")
]
WaitSeconds = Annotated[float, Query(ge=0, le=60, description="hold the answer until the job is done")]


Responses = dict[int | str, dict[str, Any]]


def answer(status: int, model: type[BaseModel], description: str) -> Responses:
    """The documentation of another answer that is no error."""
    return {status: {"model": model, "description": description}}


def problems(*statuses: int) -> Responses:
    """The documentation of the error answers of an endpoint."""
    content = {"application/problem+json": {"schema": {"$ref": f"#/components/schemas/{Problem.__name__}"}}}
    return {status: {"description": "problem", "content": content} for status in (*statuses, 422)}
