"""The service itself: whether it is ready, what it allows, and what a key has used of it."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field


class Readiness(BaseModel):
    """Which parts of the service answer."""

    status: Literal["ok", "degraded", "unavailable", "stopping"]
    checks: dict[str, str]


class Liveness(BaseModel):
    """The process answers."""

    status: Literal["ok"]


class KeyLimits(BaseModel):
    """What a key may have; null without keys, where nothing is counted."""

    requests_per_minute: int
    active_jobs: int
    stored_bytes: int


class UploadLimits(BaseModel):
    """What a file may be."""

    bytes: int
    pixels: int = Field(description="most pixels of a frame")
    frames: int
    duration_s: float
    frame_rate: float
    streams: int
    face_px: int = Field(description="width below which a face is refused")
    advised_face_px: int = Field(description="width below which there is a warning")
    formats: list[str] = Field(description="allowed formats, recognised by the first bytes of a file")


class RequestLimits(BaseModel):
    """What a request may hold."""

    json_bytes: int
    looks: int
    metadata: int = Field(description="most names of `metadata`")
    wait_s: int = Field(description="longest `wait` in seconds")
    page: int = Field(description="most entries of a page of a list")
    idempotency_s: float = Field(description="seconds for which the answer to an Idempotency-Key is kept")


class TransportLimits(BaseModel):
    """How files may come and go other than whole by one request."""

    fetches: int = Field(description="most files that are fetched from URLs at the same time")
    fetch_s: float = Field(description="longest time of a fetch from a URL, in seconds")
    redirects: int = Field(description="most redirects of such a URL")
    url_characters: int
    uploads: int = Field(description="most unfinished uploads and upload links")
    pieces: int = Field(description="most pieces of one file")
    link_s: int = Field(description="longest life of a link, in seconds")
    streams: int = Field(description="most event streams at the same time")
    previews: int = Field(description="most pictures that are waited for at the same time")
    preview_s: float = Field(description="seconds after which a picture that is not made yet is given up")


class OutputLimits(BaseModel):
    """How results can be written."""

    clips: dict[str, list[str]] = Field(description="codecs by container, for clips")
    pictures: list[str] = Field(description="containers for pictures")
    crf: dict[str, int] = Field(description="largest crf by codec, for codecs that have one")


class RetentionLimits(BaseModel):
    """How long things are kept, in seconds."""

    media_s: float = Field(
        description="from their last use: an upload of the same file, a transfer or swap, a preview or picture of a "
        "frame; no download, poster or thumbnail"
    )
    uploads_s: float = Field(description="unfinished uploads, from their last piece")
    results_s: float = Field(
        description="results, from when they are made, or the same is asked for again; downloads do not count"
    )
    jobs_s: float = Field(description="records of jobs that have ended")
    queued_s: float = Field(description="longest wait of a job for a worker")
    usage_months: int = Field(description="months that /usage lists, with the present one")


class LimitsBody(BaseModel):
    """All limits that the caller is under."""

    key: KeyLimits | None
    upload: UploadLimits
    request: RequestLimits
    transport: TransportLimits
    output: OutputLimits
    retention: RetentionLimits


class Used(BaseModel):
    """What is used of a limit; without keys there is none."""

    used: int
    limit: int | None


class RequestsUsed(Used):
    """The requests of a window, as far as they are handed out to processes of the API."""

    resets_s: int | None = Field(description="seconds until requests count anew")


class MonthBody(BaseModel):
    """What a key has had done in a month. It never falls, whatever is deleted."""

    month: str = Field(description="the month, in UTC", pattern=r"^\d{4}-\d{2}$", examples=["2026-11"])
    jobs: dict[str, int] = Field(description="jobs that ended in the month, by state")
    looks: int = Field(description="looks of jobs that succeeded in the month")
    frames: int = Field(description="frames of the videos of these looks, counted for each look")
    duration_s: float = Field(description="seconds of the videos of these looks, counted for each look")
    uploads: int = Field(description="files that became videos and references")
    upload_bytes: int


class UsageBody(BaseModel):
    """What a key has used of what it may."""

    requests: RequestsUsed
    active_jobs: Used
    stored_bytes: Used
    looks_this_month: int = Field(description="`looks` of the present month")
    jobs_this_month: dict[str, int] = Field(description="`jobs` of the present month")
    months: list[MonthBody] = Field(
        description="the present month, and earlier ones in which anything was done, newest first"
    )
