"""The bodies of requests and answers. Requests reject unknown fields."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from service.catalog import Audio, Codec, Container, Match, Part, Preset
from service.ids import MEDIA_ID

MediaId = Annotated[str, Field(pattern=MEDIA_ID.pattern, examples=["vid_0192f0c1a2b37c4d8e5f60718293a4b5"])]
Contrast = Literal["auto"] | Annotated[float, Field(ge=0.7, le=1.5)]
Faces = Literal["all"] | Annotated[list[Annotated[int, Field(ge=0)]], Field(min_length=1, max_length=64)]

CLIP_CONTAINERS = ("mp4", "mov", "mkv", "webm")
IMAGE_CONTAINERS = ("png", "jpg", "webp")
MAX_CRF_H26X = 51


class _Request(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class LookOptions(_Request):
    """How a reference's colours are put on a face."""

    strength: float = Field(default=1.0, ge=0, le=1, description="0 leaves the clip as it is, 1 is the whole transfer")
    contrast: Contrast = Field(default="auto", description="contrast of the skin: 0.7–1.5, or auto")
    match: Match = Field(default="semantic", description="all colours together, or skin to skin and lips to lips")
    protect: list[Part] = Field(default=["eyes", "teeth"], description="parts that keep their colour")
    faces: Faces = Field(default="all", description="indices of the faces to change, or all")


class LookRequest(LookOptions):
    """One output: a reference and its options."""

    reference: MediaId = Field(description="id of a reference, or of a video")


class OutputRequest(_Request):
    """How the results are encoded."""

    container: Container | None = Field(default=None, description="mp4 for clips and png for images when not given")
    codec: Codec = "auto"
    crf: int | None = Field(default=None, ge=0, le=63, description="quality: lower is better and larger")
    preset: Preset | None = None
    audio: Audio = "copy"

    @model_validator(mode="after")
    def _fits(self) -> OutputRequest:
        if self.container == "webm" and self.codec in {"h264", "hevc"}:
            raise ValueError("webm holds vp9 or av1 only")
        if self.container == "mov" and self.codec in {"vp9", "av1"}:
            raise ValueError("mov holds h264 or hevc only")
        wide = self.codec in {"vp9", "av1"} or (self.codec == "auto" and self.container == "webm")
        if self.crf is not None and self.crf > MAX_CRF_H26X and not wide:
            raise ValueError(f"the crf of h264 and hevc is at most {MAX_CRF_H26X}")
        return self


class TransferRequest(_Request):
    """Colours of one or more references on one video."""

    video: MediaId
    looks: list[LookRequest] = Field(min_length=1)
    output: OutputRequest = OutputRequest()


class SwapRequest(LookOptions):
    """The colours of ``a`` on ``b`` and of ``b`` on ``a``."""

    a: MediaId
    b: MediaId
    output: OutputRequest = OutputRequest()


class Error(BaseModel):
    """One offending value of a request."""

    detail: str
    pointer: str | None = None


class Problem(BaseModel):
    """An error (RFC 9457)."""

    type: str
    title: str
    status: int
    detail: str
    instance: str
    request_id: str
    errors: list[Error] | None = None


class StoredProblem(BaseModel):
    """Why a job or a medium failed."""

    type: str
    title: str
    detail: str


class MediaBody(BaseModel):
    """A video or a reference."""

    id: str
    state: Literal["vectorizing", "ready", "failed"]
    job: str = Field(description="the job that vectorises it")
    filename: str | None
    content_type: str
    size_bytes: int
    sha256: str
    media: dict[str, Any] | None = Field(description="size, frame rate, duration, … once ready")
    faces: list[dict[str, Any]]
    warnings: list[str]
    error: StoredProblem | None
    created_at: datetime
    expires_at: datetime


class MediaPage(BaseModel):
    """A page of media, newest first."""

    data: list[MediaBody]
    next_cursor: str | None


class ProgressBody(BaseModel):
    """How far a job is; the fraction covers the whole job, the frames its present stage."""

    stage: str | None
    fraction: float
    frames_done: int
    frames_total: int


class LookBody(BaseModel):
    """One output of a job."""

    state: str
    video: str
    reference: str
    result: str | None
    url: str | None


class JobBody(BaseModel):
    """A job."""

    id: str
    kind: Literal["vectorize", "transfer", "swap"]
    state: Literal["queued", "running", "canceling", "succeeded", "failed", "canceled", "expired"]
    done: bool
    attempt: int
    progress: ProgressBody
    media: str | None = Field(description="what a vectorize job makes ready")
    looks: list[LookBody]
    error: StoredProblem | None
    timings: dict[str, float] | None = Field(description="seconds of each part of the work")
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None


class Readiness(BaseModel):
    """Which parts of the service answer."""

    status: Literal["ok", "degraded", "unavailable"]
    checks: dict[str, Literal["ok", "unavailable"]]
