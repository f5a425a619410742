"""Jobs, their looks and what became of them."""

from __future__ import annotations

from datetime import datetime
from typing import Literal

from pydantic import BaseModel, Field

from service.api.schemas._values import Contrast, ContrastOfEach, Faces
from service.api.schemas.media import VectorBody
from service.api.schemas.problems import StoredProblem
from service.api.schemas.transfer import MakeupParts
from service.catalog import Audio, Codec, Container, Extent, Extra, Feature, Match, MatteFormat, PartName, Preset

State = Literal["queued", "running", "canceling", "succeeded", "failed", "canceled", "expired"]


class ProgressBody(BaseModel):
    """How far a job is; the fraction covers the whole job, the frames its present stage."""

    stage: str | None = Field(
        description="what the worker does: vectorize and second reading (of a video), landmarks and best frame (of a "
        "clip that is a reference), transfer, render, extras, join (of a job in parts); null before the first"
    )
    fraction: float
    frames_done: int
    frames_total: int


class ExtraBody(BaseModel):
    """What was made beside a result, see `output.extras`."""

    part: PartName
    person: int = Field(description="number of the person, from 1, if the look changes several")
    url: str
    size_bytes: int
    sha256: str
    content_type: str
    expires_at: datetime


class OptionsBody(BaseModel):
    """How a look was asked for, defaults included: a request may have it as it is."""

    strength: float
    contrast: Contrast | ContrastOfEach = Field(description="two values if two faces exchange their colours")
    match: Match
    protect: list[Feature]
    faces: Faces
    makeup: float | MakeupParts
    light: float
    scene: float
    extent: Extent
    reference_face: int | None
    beta: float
    iterations: int
    seed: int


class OutputBody(BaseModel):
    """How the results of a job were asked to be written, defaults included."""

    container: Container | None = Field(description="null: mp4 for a clip, png for a picture")
    codec: Codec
    crf: int | None
    preset: Preset | None
    audio: Audio
    extras: list[Extra]
    matte: MatteFormat


class LookBody(BaseModel):
    """One output of a job."""

    state: State
    video: str
    reference: str
    options: OptionsBody
    settings: VectorBody | None = Field(description="how its video was vectorised; null until the look is made")
    warnings: list[str] = Field(
        description="what may spoil the look, and what of the video its file does not keep; empty until it is made"
    )
    result: str | None
    result_gone: Literal["expired", "deleted"] | None = Field(
        description="why the result is gone: it, or one of its media, has `expired` or was `deleted`"
    )
    url: str | None
    size_bytes: int | None = Field(description="size of the result; null until it is made, and once it is gone")
    content_type: str | None
    sha256: str | None
    expires_at: datetime | None
    extras: list[ExtraBody] = Field(description="what `output.extras` asked for; empty until it is made")


class QueueBody(BaseModel):
    """Where a job stands among those that wait for a worker."""

    position: int = Field(ge=1, description="1 is next; others may still come before it, since keys take turns")


class EtaBody(BaseModel):
    """When a job will be done, in seconds from its last change; measured on jobs like it."""

    seconds: float = Field(ge=0, description="half of the jobs like it take less")
    low: float = Field(ge=0, description="about one in ten of them takes less")
    high: float = Field(ge=0, description="about one in ten of them takes more")


class Timings(BaseModel):
    """Seconds of the parts of a job; null for those it did not have."""

    waited_s: float | None = Field(default=None, description="wait for media that were not ready")
    queued_s: float | None = Field(default=None, description="wait for a worker, since the job was last queued")
    vectorize_s: float | None = None
    transfer_s: float | None = None
    render_s: float | None = Field(
        default=None, description="rendering; the sum over its parts if the job was done in parts"
    )
    join_s: float | None = Field(default=None, description="joining the parts of a job")
    extras_s: float | None = None
    cpu_s: float | None = Field(default=None, description="processor time of drawing and joining the parts of a job")
    store_s: float | None = None


class JobBody(BaseModel):
    """A job."""

    id: str
    kind: Literal["vectorize", "transfer", "swap"]
    state: State
    done: bool
    attempt: int
    waiting_for: Literal["media", "room"] | None = Field(
        description="why a queued job cannot begin yet: `media` are being vectorised, or there is no `room` on the disk"
    )
    progress: ProgressBody
    queue: QueueBody | None = Field(description="place in the queue, if the job waits only for a worker")
    eta: EtaBody | None = Field(description="time until it is done; null until enough jobs like it have been measured")
    media: str | None = Field(description="id of the medium that a `vectorize` job makes ready")
    looks: list[LookBody]
    output: OutputBody | None = Field(description="how its results are written; null for a `vectorize` job")
    error: StoredProblem | None
    timings: Timings | None = Field(description="seconds of each phase, as far as they are known")
    metadata: dict[str, str]
    traceparent: str | None = Field(description="W3C Trace Context of the request that made it")
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    expires_at: datetime | None = Field(
        description="when its record may be deleted: not before its results or the medium that it made; null until the "
        "job has ended"
    )


class JobPage(BaseModel):
    """A page of jobs, newest first."""

    data: list[JobBody]
    next_cursor: str | None
