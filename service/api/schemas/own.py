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
    pixels: int = Field(description="of one picture or frame")
    frames: int
    duration_s: float
    frame_rate: float
    streams: int
    face_px: int = Field(description="width below which a face is refused")
    advised_face_px: int = Field(description="width below which there is a warning")
    formats: list[str] = Field(description="containers and picture formats, as they are recognised by their bytes")


class RequestLimits(BaseModel):
    """What a request may hold."""

    json_bytes: int
    looks: int
    metadata: int = Field(description="names")
    wait_s: int = Field(description="for which an answer may be held")
    page: int = Field(description="entries of a list at once")
    idempotency_s: float = Field(description="for which the answer to an Idempotency-Key is kept")


class TransportLimits(BaseModel):
    """How files may come and go other than whole by one request."""

    fetches: int = Field(description="files fetched at a time that are named by their URLs")
    fetch_s: float = Field(description="seconds in which a file that is named by its URL must have come")
    redirects: int = Field(description="of such a URL")
    url_characters: int
    uploads: int = Field(description="in pieces or by a link, that are not complete")
    pieces: int = Field(description="of one file by tus, as they are kept")
    link_s: int = Field(description="the longest that a link may be used")
    streams: int = Field(description="of events at a time")
    previews: int = Field(description="pictures that may be waited for at a time")
    preview_s: float = Field(description="seconds after which a picture that is not made is given up")


class OutputLimits(BaseModel):
    """How results can be written."""

    clips: dict[str, list[str]] = Field(description="the codecs that each container of clips holds")
    pictures: list[str] = Field(description="containers of pictures")
    crf: dict[str, int] = Field(description="the codecs that have a crf, and the largest")


class RetentionLimits(BaseModel):
    """How long things are kept, in seconds."""

    media_s: float = Field(
        description="from their last use: an upload of the same file, a transfer or swap, a preview or picture of a "
        "frame; no download, poster or thumbnail"
    )
    uploads_s: float = Field(description="what has arrived of a file in pieces, from its last piece")
    results_s: float = Field(description="from when they are made, or the same is asked for again; no download")
    jobs_s: float = Field(description="records of jobs that have ended")
    queued_s: float = Field(description="the longest that a job waits for a worker")
    usage_months: int = Field(description="months that /usage tells of, with the present one")


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

    resets_s: int | None = Field(description="seconds until the next window")


class MonthBody(BaseModel):
    """What a key has had done in a month. It never falls, whatever is deleted."""

    month: str = Field(description="of UTC", pattern=r"^\d{4}-\d{2}$", examples=["2026-11"])
    jobs: dict[str, int] = Field(description="that ended in it, by state")
    looks: int = Field(description="of jobs that succeeded in it")
    frames: int = Field(description="of the videos of these looks, once for each look")
    duration_s: float = Field(description="the same in seconds")
    uploads: int = Field(description="files that became videos and references")
    upload_bytes: int


class UsageBody(BaseModel):
    """What a key has used of what it may."""

    requests: RequestsUsed
    active_jobs: Used
    stored_bytes: Used
    looks_this_month: int = Field(description="`looks` of the first of the months")
    jobs_this_month: dict[str, int] = Field(description="`jobs` of the first of the months")
    months: list[MonthBody] = Field(description="this one, and those before it with anything in them, newest first")
