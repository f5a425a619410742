"""Files that come by an address, in pieces or by a link, and links to files."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Final, Literal, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo, WithJsonSchema, field_validator

from service.api.schemas._values import RECEIVER_URL, WHOLE, Metadata, Request, WebhookRequest, Whole
from service.api.schemas.media import ReferenceOptions, VectorBody, VideoOptions
from service.catalog import PartName

Url = Annotated[
    str,
    Field(
        description="of http or https, at a public address; it is fetched before the answer",
        examples=["https://media.example/clip.mp4"],
        # said here, checked where it is fetched from, which says better what is wrong with it
        json_schema_extra={"pattern": RECEIVER_URL, "maxLength": 2048},
    ),
]
#: a link lives for so long when nobody says otherwise, and at most
LINK_S: Final = 3600
MAX_LINK_S: Final = 7 * 86_400
LinkSeconds = Annotated[int, Field(ge=1, le=MAX_LINK_S, description="for which the link may be used"), WHOLE]


class ReferenceByUrl(ReferenceOptions):
    """A reference that is fetched."""

    url: Url
    webhook: WebhookRequest | None = None
    metadata: Metadata = Field(default={})


class VideoByUrl(VideoOptions):
    """A video that is fetched."""

    url: Url
    webhook: WebhookRequest | None = None
    metadata: Metadata = Field(default={})


#: one of them has two names: `output.extras` asks for it by the shorter
Part = Annotated[
    PartName,
    BeforeValidator(lambda name: "look.cube" if name == "cube" else name),
    WithJsonSchema({"type": "string", "enum": [*get_args(PartName), "cube"]}),
]


class ResultLinkRequest(Request):
    """A link to a result, or to a part of one."""

    # as `_of_a_part` has it
    model_config = ConfigDict(
        json_schema_extra={
            "anyOf": [
                {"properties": {"person": {"const": 1}}},
                {"required": ["part"], "properties": {"part": {"type": "string"}}},
            ]
        }
    )

    expires_in_s: LinkSeconds = LINK_S
    part: Part | None = Field(default=None, description="what was made beside it; the result itself when not given")
    person: Whole = Field(default=1, ge=1, le=1000, description="of the part: which of the persons")

    @field_validator("person")
    @classmethod
    def _of_a_part(cls, person: int, info: ValidationInfo) -> int:
        # a default that is said is as one that is not
        if person > 1 and info.data.get("part", "") is None:
            raise ValueError("only a part has persons: give `part`, matte or look.cube")
        return person


class UploadLinkRequest(VideoOptions):
    """A link by which one file may be uploaded."""

    role: Literal["video", "reference"] = "video"
    expires_in_s: LinkSeconds = LINK_S
    max_bytes: Annotated[int, Field(ge=1), WHOLE] | None = Field(
        default=None, description="of the file; that of any upload when not given, or when it is more"
    )
    webhook: WebhookRequest | None = None
    metadata: Metadata = Field(default={})


class LinkBody(BaseModel):
    """A link that needs no key."""

    url: str = Field(description="without scheme and host when it leads to this service")
    expires_at: datetime


class UploadLinkBody(LinkBody):
    """A link by which one file may be uploaded."""

    id: str = Field(description="of the upload")
    max_bytes: int = Field(description="of the file, as it is kept to")


class UploadBody(BaseModel):
    """A file that arrives in pieces, or by a link."""

    id: str
    role: Literal["video", "reference"]
    filename: str | None
    size_bytes: int | None = Field(description="null as long as its sender has not said it")
    offset_bytes: int = Field(description="how much of it is there")
    media: str | None = Field(
        description="the video or reference that it has become, once all of it is there; by a link null where there "
        "are keys"
    )
    created_at: datetime
    expires_at: datetime = Field(description="when what is there of it goes")


class OpenUploadBody(UploadBody):
    """A file that has not arrived: in pieces, or by a link that was made for it."""

    url: str = Field(description="where it goes on and is deleted, with the key; of a link without what opens it")
    settings: VectorBody = Field(description="how it will be vectorised")
    metadata: dict[str, str]


class UploadPage(BaseModel):
    """A page of files that have not arrived, newest first."""

    data: list[OpenUploadBody]
    next_cursor: str | None
