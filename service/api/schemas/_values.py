"""Values that several bodies have, and what all bodies of requests share: they reject unknown fields."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, StringConstraints

from service.ids import MEDIA_ID

MediaId = Annotated[str, Field(pattern=MEDIA_ID.pattern, examples=["vid_0192f0c1a2b37c4d8e5f60718293a4b5"])]


def _whole(value: object) -> object:
    """A number without a fraction is an integer, however it is written (JSON Schema 2020-12, 4.2.3)."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _as_set(values: list[str]) -> list[str]:
    """Of a list whose order says nothing, each once and in one order: however it is written, it asks for the same."""
    return sorted(set(values))


AS_SET: Final = AfterValidator(_as_set)
#: stands after the bounds of a number: before them, the schema would not have them
WHOLE: Final = BeforeValidator(_whole)
Whole = Annotated[int, WHOLE]
#: index of a face; no medium has more
Index = Annotated[int, Field(ge=0, le=1000), WHOLE]
Contrast = Literal["auto"] | Annotated[float, Field(ge=0.7, le=1.5)]
Share = Annotated[float, Field(ge=0, le=1)]
ContrastOfEach = Annotated[list[Contrast], Field(min_length=2, max_length=2)]
Faces = Literal["all"] | Annotated[list[Index], Field(min_length=1, max_length=64)]
#: of a list of words, each of which may be there again
MAX_WORDS = 64

#: names that a thing may have
MAX_METADATA = 16
METADATA_NAME = r"[A-Za-z0-9_.-]{1,40}"
METADATA_VALUE = r"[^\x00-\x1f\x7f]{0,200}"
#: a name and a value as a query or a form has them
METADATA_PAIR = f"^{METADATA_NAME}:{METADATA_VALUE}$"
MetadataPair = Annotated[str, StringConstraints(pattern=METADATA_PAIR)]
MetadataPairs = Annotated[list[MetadataPair], Field(max_length=MAX_METADATA)]
Metadata = Annotated[
    dict[
        Annotated[str, StringConstraints(pattern=f"^{METADATA_NAME}$")],
        Annotated[str, StringConstraints(pattern=f"^{METADATA_VALUE}$")],
    ],
    Field(
        max_length=MAX_METADATA,
        description="up to 16 names and values of your own, returned and never interpreted",
        examples=[{"order": "42"}],
    ),
]
Force = Annotated[bool, Field(description="make a new job even if the same transfer or swap was asked for before")]


class Request(BaseModel):
    """The body of a request."""

    model_config = ConfigDict(extra="forbid", frozen=True)


RECEIVER_URL = r"^[Hh][Tt][Tt][Pp][Ss]?://[\x21-\x7e]+$"


class WebhookRequest(Request):
    """The receiver that is told of the job's end."""

    url: str = Field(
        description="address that gets a POST, signed by Standard Webhooks; http or https, and public",
        examples=["https://studio.example/hooks/pvg"],
        # said here, checked by `service.api.receivers`, which says better what is wrong with it
        json_schema_extra={"pattern": RECEIVER_URL, "maxLength": 2048},
    )
