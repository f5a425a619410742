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

    mask: Mask = Field(default="landmarks", description="how the skin is found; ycbcr: the paper's rule")
    input_color: InputColor = Field(
        default="auto", description="how the file is coded; auto believes its tags, logs of cameras must be named"
    )


class VideoOptions(ReferenceOptions):
    """How a video is vectorised."""

    matching: Matching = Field(default="table", description="how colours are carried; chain: the paper's way")


class VectorBody(BaseModel):
    """How a medium is vectorised."""

    mask: str
    matching: str
    input_color: str


class MediaInfo(BaseModel):
    """What a file is, as it was found when it was vectorised."""

    kind: Literal["video", "image"]
    width: int = Field(description="pixels, upright")
    height: int
    frame_rate: float | None = Field(description="frames a second; of a picture there is none")
    frame_count: int
    duration_s: float
    codec: str
    pixel_format: str
    has_audio: bool
    rotation: int = Field(description="degrees by which the file asks to be turned when it is shown")
    color: str = Field(description="how its colours are read, such as `SDR` or `PQ BT.2020`")
    color_primaries: int = Field(description="of ITU-T H.273, table 2")
    color_transfer: int = Field(description="of ITU-T H.273, table 3")


class FaceBody(BaseModel):
    """One face, or one person, of a medium."""

    index: int = Field(description="by which requests name it")
    first_frame: int
    last_frame: int
    width_px: float
    skin_rgb: Annotated[list[int], Field(min_length=3, max_length=3)] = Field(description="0–255")
    warnings: list[str]
    frame: int | None = Field(default=None, description="where it is seen well; null where there is no thumbnail")
    box: Annotated[list[int], Field(min_length=4, max_length=4)] | None = Field(
        default=None, description="x, y, width and height in that frame, in pixels"
    )
    thumbnail: str | None = Field(default=None, description="where a small picture of it is, once the medium is ready")


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
    media: MediaInfo | None = Field(description="once it is ready")
    poster: str | None = Field(description="a small picture of it, once it is ready")
    faces: list[FaceBody] = Field(description="once it is ready")
    warnings: list[str] = Field(description="of its faces, and what an mp4 made of it does not keep of its file")
    metadata: dict[str, str]
    error: StoredProblem | None
    created_at: datetime
    expires_at: datetime


class MediaPage(BaseModel):
    """A page of media, newest first."""

    data: list[MediaBody]
    next_cursor: str | None
