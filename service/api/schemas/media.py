"""Media: how they are vectorised, and how they are shown."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import BaseModel, Field

from service.api.schemas._values import Request
from service.api.schemas.problems import StoredProblem
from service.catalog import InputColor, Mask, Matching


class ReferenceOptions(Request):
    """How a reference is vectorised."""

    mask: Mask = Field(default="landmarks", description="how skin is found; `ycbcr` is the paper's rule")
    input_color: InputColor = Field(
        default="auto",
        description="how the file's colours are coded; `auto` goes by its tags, a camera's logarithm must be named",
    )


class VideoOptions(ReferenceOptions):
    """How a video is vectorised."""

    matching: Matching = Field(
        default="table", description="how colours go from frame to frame; `chain` is the paper's way"
    )


class VectorBody(BaseModel):
    """How a medium is vectorised."""

    mask: str
    matching: str
    input_color: str


class MediaInfo(BaseModel):
    """What a file is, as it was found when it was vectorised."""

    kind: Literal["video", "image"]
    width: int = Field(description="in pixels, when shown upright")
    height: int
    frame_rate: float | None = Field(description="frames a second; null for a picture")
    frame_count: int
    duration_s: float
    codec: str
    pixel_format: str
    has_audio: bool
    rotation: int = Field(description="degrees by which the file is turned when it is shown")
    color: str = Field(description="how its colours are read, such as `SDR` or `PQ BT.2020`")
    color_primaries: int = Field(description="a code of ITU-T H.273, table 2")
    color_transfer: int = Field(description="a code of ITU-T H.273, table 3")


class FaceBody(BaseModel):
    """One face, or one person, of a medium."""

    index: int = Field(description="number of the face in requests")
    first_frame: int
    last_frame: int
    width_px: float
    skin_rgb: Annotated[list[int], Field(min_length=3, max_length=3)] = Field(
        description="median colour of the skin, 0–255"
    )
    warnings: list[str]
    frame: int | None = Field(
        default=None, description="number of a frame that shows it well; null without a thumbnail"
    )
    box: Annotated[list[int], Field(min_length=4, max_length=4)] | None = Field(
        default=None, description="x, y, width and height in that frame, in pixels"
    )
    thumbnail: str | None = Field(
        default=None, description="address of a small picture of it, once the medium is ready"
    )


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
    media: MediaInfo | None = Field(description="what the file is; null until it is ready")
    poster: str | None = Field(description="address of a small picture; null until it is ready")
    faces: list[FaceBody] = Field(description="faces in it; empty until it is ready")
    warnings: list[str] = Field(description="warnings of its faces, and what an mp4 made of it does not keep")
    metadata: dict[str, str]
    error: StoredProblem | None
    created_at: datetime
    expires_at: datetime


class MediaPage(BaseModel):
    """A page of media, newest first."""

    data: list[MediaBody]
    next_cursor: str | None
