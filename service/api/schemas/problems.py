"""What went wrong."""

from __future__ import annotations

from typing import Final

from pydantic import BaseModel, Field

_OF_FILES: Final = "of what a file holds seconds, frames, pixels, frames per second, streams, bytes of memory"


class Error(BaseModel):
    """One offending value of a request."""

    detail: str
    pointer: str | None = None


class Problem(BaseModel):
    """An error (RFC 9457)."""

    type: str = Field(description="address of a description of this kind of problem: `/docs/problems#` and the `code`")
    code: str = Field(description="kind of problem, the same everywhere: what a program should check")
    title: str
    status: int
    detail: str
    instance: str = Field(description="path of the request")
    request_id: str
    errors: list[Error] | None = Field(default=None, description="what is wrong, value by value; the first 100")
    limit: float | None = Field(default=None, description="how much is allowed, if a limit was exceeded")
    unit: str | None = Field(
        default=None,
        description="of `limit`: bytes, files, jobs, looks, uploads, pictures, streams, requests per minute or at a "
        f"time; {_OF_FILES}",
    )


class StoredProblem(BaseModel):
    """Why a job or a medium failed."""

    type: str = Field(description="as in a problem that is answered")
    code: str
    title: str
    detail: str
    errors: list[Error] | None = Field(
        default=None,
        exclude_if=lambda errors: errors is None,
        description="where in the JSON of the job's request the fault is, if that is known",
    )
    limit: float | None = Field(
        default=None, exclude_if=lambda limit: limit is None, description="how much is allowed, if a limit was exceeded"
    )
    unit: str | None = Field(default=None, exclude_if=lambda unit: unit is None, description=f"of `limit`: {_OF_FILES}")
