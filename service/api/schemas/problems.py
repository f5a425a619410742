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

    type: str = Field(
        description="where this service tells of the kind: the path of the proxy, `/docs/problems#`, `code`"
    )
    code: str = Field(description="the kind, the same at every installation")
    title: str
    status: int
    detail: str
    instance: str = Field(description="the path of the request")
    request_id: str
    errors: list[Error] | None = Field(default=None, description="what is wrong, value by value: the first 100")
    limit: float | None = Field(default=None, description="the most that is allowed, of what was gone over")
    unit: str | None = Field(
        default=None,
        description="of `limit`: bytes, files, jobs, looks, uploads, pictures, streams, requests per minute or at a "
        f"time; {_OF_FILES}",
    )


class StoredProblem(BaseModel):
    """Why a job or a medium failed."""

    type: str = Field(description="as of the problem of an answer")
    code: str
    title: str
    detail: str
    errors: list[Error] | None = Field(
        default=None,
        exclude_if=lambda errors: errors is None,
        description="where in the request of the job it is, where that is known, by pointers as into its JSON",
    )
    limit: float | None = Field(
        default=None, exclude_if=lambda limit: limit is None, description="the most that is accepted of what is over it"
    )
    unit: str | None = Field(default=None, exclude_if=lambda unit: unit is None, description=f"of `limit`: {_OF_FILES}")
