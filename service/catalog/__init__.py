"""The records: media, jobs, looks and results in the database, and the state machines that keep them consistent.

`jobs`, `media`, `results` and `sweep` hold the operations, each on an open transaction of `Database`.
"""

from __future__ import annotations

from service.catalog import jobs, media, results, sweep
from service.catalog.database import Clock, Database, utc_now
from service.catalog.jobs import Message, NewLook, Progress
from service.catalog.media import Asset, Upload
from service.catalog.media_types import AVI, JPEG, MKV, MOV, MP4, PNG, WEBM, WEBP, FileType, content_type_of
from service.catalog.models import ENDED, Job, JobKind, JobState, Look, Media, MediaState, Result, Role
from service.catalog.requests import (
    Audio,
    Codec,
    Container,
    LookParams,
    Match,
    OutputOptions,
    Part,
    Preset,
    RenderRequest,
    VectorizeRequest,
    look_params,
    render_request,
    vectorize_request,
)
from service.catalog.results import Output
from service.catalog.transitions import Lease

__all__ = [
    "AVI",
    "ENDED",
    "JPEG",
    "MKV",
    "MOV",
    "MP4",
    "PNG",
    "WEBM",
    "WEBP",
    "Asset",
    "Audio",
    "Clock",
    "Codec",
    "Container",
    "Database",
    "FileType",
    "Job",
    "JobKind",
    "JobState",
    "Lease",
    "Look",
    "LookParams",
    "Match",
    "Media",
    "MediaState",
    "Message",
    "NewLook",
    "Output",
    "OutputOptions",
    "Part",
    "Preset",
    "Progress",
    "RenderRequest",
    "Result",
    "Role",
    "Upload",
    "VectorizeRequest",
    "content_type_of",
    "jobs",
    "look_params",
    "media",
    "render_request",
    "results",
    "sweep",
    "utc_now",
    "vectorize_request",
]
