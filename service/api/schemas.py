"""The bodies of requests and answers. Requests reject unknown fields."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from service.catalog import Audio, Codec, Container, Extent, Mask, Match, Matching, Part, Preset
from service.ids import MEDIA_ID

MediaId = Annotated[str, Field(pattern=MEDIA_ID.pattern, examples=["vid_0192f0c1a2b37c4d8e5f60718293a4b5"])]
Contrast = Literal["auto"] | Annotated[float, Field(ge=0.7, le=1.5)]
Share = Annotated[float, Field(ge=0, le=1)]
ContrastOfEach = Annotated[list[Contrast], Field(min_length=2, max_length=2)]
Faces = Literal["all"] | Annotated[list[Annotated[int, Field(ge=0)]], Field(min_length=1, max_length=64)]

CLIP_CONTAINERS = ("mp4", "mov", "mkv", "webm")
IMAGE_CONTAINERS = ("png", "jpg", "webp")
MAX_CRF_H26X = 51
#: the transport has settled long before, and a request must not ask for minutes of it
MAX_ITERATIONS = 200
MAKEUP = 0.75
MAX_SEED = 2**32 - 1


class _Request(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ReferenceOptions(_Request):
    """How a reference is vectorised."""

    mask: Mask = Field(default="landmarks", description="how the skin is found; ycbcr: the paper's rule")


class VideoOptions(ReferenceOptions):
    """How a video is vectorised."""

    matching: Matching = Field(default="table", description="how colours are carried; chain: the paper's way")


class MakeupParts(_Request):
    """How far each part takes the reference's make-up."""

    lips: Share = MAKEUP
    lids: Share = MAKEUP
    cheeks: Share = MAKEUP
    brows: Share = MAKEUP


class _ColorOptions(_Request):
    strength: float = Field(default=1.0, ge=0, le=1, description="0 leaves the clip as it is, 1 is the whole transfer")
    match: Match = Field(default="semantic", description="all colours together, or skin to skin and lips to lips")
    protect: list[Part] = Field(default=["eyes", "teeth"], description="parts that keep their colour")
    faces: Faces = Field(default="all", description="indices of the faces to change, or all")
    makeup: Share | MakeupParts = Field(
        default=MAKEUP, description="how far lips, lids, cheeks and brows take the reference's make-up: all, or by part"
    )
    light: Share = Field(default=0.25, description="how far light falls from where it does on the reference")
    extent: Extent = Field(default="skin", description="all skin of the person, or the face with ears and neck alone")
    reference_face: int | None = Field(
        default=None, ge=0, le=1000, description="index of the reference's face; its largest when not given"
    )
    beta: float = Field(default=0.2, gt=0, le=1, description="β of the paper's eq. (7)")
    iterations: int = Field(default=20, ge=0, le=MAX_ITERATIONS, description="N of the paper's eq. (7)")
    seed: int = Field(default=0, ge=0, le=MAX_SEED, description="of the transport's random rotations")


class LookOptions(_ColorOptions):
    """How a reference's colours are put on a face."""

    contrast: Contrast = Field(default="auto", description="contrast of the skin: 0.7–1.5, or auto")


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


class SwapRequest(_ColorOptions):
    """The colours of ``a`` on ``b`` and of ``b`` on ``a``; without ``b``, two ``faces`` of ``a`` exchange theirs."""

    a: MediaId
    b: MediaId | None = Field(default=None, description="another video; without it, two faces of `a` are exchanged")
    contrast: Contrast | ContrastOfEach = Field(
        default="auto", description="contrast of the skin: 0.7–1.5, or auto; for both sides, or for each"
    )
    output: OutputRequest = OutputRequest()

    @property
    def contrasts(self) -> tuple[Contrast, Contrast]:
        """The contrast of either side."""
        if isinstance(self.contrast, list):
            return self.contrast[0], self.contrast[1]
        return self.contrast, self.contrast

    def side(self, contrast: Contrast) -> LookOptions:
        """The options of one side."""
        return LookOptions(**{name: getattr(self, name) for name in _ColorOptions.model_fields}, contrast=contrast)


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


class VectorBody(BaseModel):
    """How a medium is vectorised."""

    mask: str
    matching: str


class MediaBody(BaseModel):
    """A video or a reference."""

    id: str
    state: Literal["vectorizing", "ready", "failed"]
    job: str = Field(description="the job that vectorises it")
    filename: str | None
    content_type: str
    size_bytes: int
    sha256: str
    settings: VectorBody
    media: dict[str, Any] | None = Field(description="size, frame rate, duration, … once ready")
    faces: list[dict[str, Any]] = Field(description="index, frames, width, skin colour and warnings of each face")
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
    options: dict[str, Any] = Field(description="how it was asked for, defaults included")
    settings: VectorBody | None = Field(description="how its video was vectorised, once it is drawn")
    warnings: list[str] = Field(description="what may spoil it, such as a small face, once it is drawn")
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
