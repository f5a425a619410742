"""The body of `POST /preview`."""

from __future__ import annotations

from typing import Annotated, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo, WithJsonSchema, field_validator

from service.api.schemas import WHOLE, LookRequest, MediaId, Whole
from service.catalog import StillFormat

#: widest picture that is made, in pixels; posters and sliders need a tenth
MAX_WIDTH = 8192
_USUAL_WIDTH = 1280
#: one of them has two names
_Format = Annotated[
    StillFormat,
    BeforeValidator(lambda name: "jpeg" if name == "jpg" else name),
    WithJsonSchema({"type": "string", "enum": [*get_args(StillFormat), "jpg"]}),
]
_Corner = Annotated[int, Field(ge=0, le=100_000), WHOLE]
_Length = Annotated[int, Field(ge=1, le=100_000), WHOLE]
_Frame = Annotated[int, Field(ge=0, le=2**31 - 1), WHOLE]


class PreviewRequest(BaseModel):
    """One frame of a video with one look."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    video: MediaId
    look: LookRequest | None = Field(default=None, description="as in a transfer; without it the frame is as it is")
    before: bool = Field(default=False, description="the frame without the look, to be compared with it")
    frame: _Frame | None = Field(
        default=None, description="from 0; without it and `time_s`, one that shows the faces well"
    )
    time_s: float | None = Field(default=None, ge=0, le=1e6, description="seconds after the first frame")
    nearest: bool = Field(
        default=False, description="the nearest frame that is quick to have, at a key picture, instead of the very one"
    )
    crop: tuple[_Corner, _Corner, _Length, _Length] | None = Field(
        default=None, description="x, y, width and height of a part of the picture, in its pixels"
    )
    face: _Corner | None = Field(default=None, description="index of a face to show alone")
    max_width: Whole = Field(default=_USUAL_WIDTH, ge=16, le=MAX_WIDTH, description="wider pictures are scaled down")
    format: _Format = "jpeg"

    @field_validator("time_s")
    @classmethod
    def _one_frame(cls, time_s: float | None, info: ValidationInfo) -> float | None:
        if time_s is not None and info.data.get("frame") is not None:
            raise ValueError("frame and time_s both say which frame; give one of them")
        return time_s

    @field_validator("face")
    @classmethod
    def _one_part(cls, face: int | None, info: ValidationInfo) -> int | None:
        if face is not None and info.data.get("crop") is not None:
            raise ValueError("crop and face both say which part; give one of them")
        return face
