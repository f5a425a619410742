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
    DEFAULT_VECTOR_SETTINGS,
    Audio,
    Codec,
    Container,
    Extent,
    LookParams,
    Mask,
    Match,
    Matching,
    OutputOptions,
    Part,
    Preset,
    RenderRequest,
    VectorizeRequest,
    VectorSettings,
    look_params,
    render_request,
    vectorize_request,
)
from service.catalog.results import Output, Report
from service.catalog.transitions import Lease

__all__ = [
    "AVI",
    "DEFAULT_VECTOR_SETTINGS",
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
    "Extent",
    "FileType",
    "Job",
    "JobKind",
    "JobState",
    "Lease",
    "Look",
    "LookParams",
    "Mask",
    "Match",
    "Matching",
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
    "Report",
    "Result",
    "Role",
    "Upload",
    "VectorSettings",
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
