"""What transfers and swaps are asked for."""

from __future__ import annotations

from typing import Annotated, get_args

from pydantic import BeforeValidator, Field, ValidationInfo, WithJsonSchema, field_validator

from service.api.schemas._values import (
    AS_SET,
    MAX_WORDS,
    WHOLE,
    Contrast,
    ContrastOfEach,
    Faces,
    Force,
    Index,
    MediaId,
    Metadata,
    Request,
    Share,
    WebhookRequest,
    Whole,
)
from service.catalog import (
    HELD,
    IMAGE_CONTAINERS,
    MAKEUP,
    MAX_CRF,
    Audio,
    Codec,
    Container,
    Extent,
    Extra,
    Feature,
    LookParams,
    Match,
    MatteFormat,
    Preset,
)
from service.settings import MAX_LOOKS

#: one of them has two names
ContainerName = Annotated[
    Container,
    BeforeValidator(lambda name: "jpg" if name == "jpeg" else name),
    WithJsonSchema({"type": "string", "enum": [*get_args(Container), "jpeg"]}),
]
#: what each kind of video becomes unless it is asked for another
USUAL_CONTAINERS = frozenset({"mp4", "png"})
#: the transport has settled long before, and a request must not ask for minutes of it
MAX_ITERATIONS = 200
MAX_SEED = 2**32 - 1
#: what is not asked for is as it is recorded by default
_USUAL = LookParams()


class MakeupParts(Request):
    """How far each part takes the reference's make-up: 0.75 for those that are not named, 0 to leave one out."""

    lips: Share = MAKEUP
    lids: Share = MAKEUP
    cheeks: Share = MAKEUP
    brows: Share = MAKEUP


class _ColorOptions(Request):
    strength: float = Field(
        default=_USUAL.strength, ge=0, le=1, description="0 leaves the clip as it is, 1 is the whole transfer"
    )
    match: Match = Field(
        default=_USUAL.match,
        description="`semantic`: skin to skin, lips to lips; `color`: all colours together, as in the paper",
    )
    protect: Annotated[list[Feature], AS_SET] = Field(
        default=[*_USUAL.protect],
        max_length=MAX_WORDS,
        description="parts that follow the skin only in brightness and half its hue; others take the whole look",
    )
    faces: Faces = Field(default="all", description="`all`, or the indices of the faces to change")
    makeup: Share | MakeupParts = Field(
        default=MAKEUP,
        description="how far the reference's make-up is taken over: one number, or one by part (lips, lids, cheeks, "
        "brows); parts that are not named have 0.75",
    )
    light: Share = Field(default=_USUAL.light, description="how far the place of the reference's light is taken over")
    scene: Share = Field(
        default=_USUAL.scene,
        description="how far the look gives way to the clip's brightness and hue; 0 takes the reference's own colours",
    )
    extent: Extent = Field(
        default=_USUAL.extent, description="`skin`: all skin of the person; `face`: without chest, arms and hands"
    )
    reference_face: Index | None = Field(
        default=None, description="index of the reference's face; without it, the largest face"
    )
    beta: float = Field(default=_USUAL.beta, gt=0, le=1, description="β of the paper's eq. (7)")
    iterations: Whole = Field(
        default=_USUAL.iterations, ge=0, le=MAX_ITERATIONS, description="N of the paper's eq. (7)"
    )
    seed: Whole = Field(
        default=_USUAL.seed, ge=0, le=MAX_SEED, description="seed of the random rotations of the colour transport"
    )


class LookOptions(_ColorOptions):
    """How a reference's colours are put on a face."""

    contrast: Contrast = Field(default="auto", description="contrast of the skin: 0.7–1.5, or auto")


class LookRequest(LookOptions):
    """One output: a reference and its options."""

    reference: MediaId = Field(description="id of a reference, or of a video")

    @field_validator("faces")
    @classmethod
    def _in_one_order(cls, faces: Faces) -> Faces:
        # those of a swap say whose colours go where
        return faces if faces == "all" else sorted(set(faces))


class OutputRequest(Request):
    """How the results are encoded."""

    container: ContainerName | None = Field(default=None, description="mp4 for clips and png for images when not given")
    codec: Codec = Field(default="auto", description="one that the container holds; auto: by the clip's depth")
    crf: Annotated[int, Field(ge=0, le=63), WHOLE] | None = Field(
        default=None,
        description="quality, lower is better and larger; 18 (h264), 20 (hevc), 28 (vp9), 26 (av1) when not given",
    )
    preset: Preset | None = Field(default=None, description="effort; veryfast when not given")
    audio: Audio = Field(default="copy", description="all sound tracks of the clip, or none")
    extras: Annotated[list[Extra], AS_SET] = Field(
        default=[],
        max_length=MAX_WORDS,
        description="made beside each result: cube, its colours as a 3D LUT, and matte, where they lie",
    )
    matte: MatteFormat = Field(
        default="ffv1", description="grey in mkv, or ProRes 4444 with alpha in mov; that of a picture is a png"
    )

    # each field is checked with those before it, so that an error is of the field that does not fit

    @field_validator("codec")
    @classmethod
    def _held(cls, codec: Codec, info: ValidationInfo) -> Codec:
        container = info.data.get("container", "png") or "mp4"
        if container not in IMAGE_CONTAINERS and codec not in {"auto", *HELD[container]}:
            others = [name for name, held in HELD.items() if codec in held]
            raise ValueError(f"{container} does not hold {codec}; {' and '.join(others)} do")
        return codec

    @field_validator("crf", "preset")
    @classmethod
    def _of_the_codec(cls, value: int | str | None, info: ValidationInfo) -> int | str | None:
        container, codec = info.data.get("container", "png") or "mp4", info.data.get("codec")
        if value is None or codec is None or container in IMAGE_CONTAINERS:
            return value
        if codec == "auto":
            codec = "vp9" if container == "webm" else "h264"
        if codec not in MAX_CRF:
            raise ValueError(f"{codec} has neither crf nor preset")
        if isinstance(value, int) and value > MAX_CRF[codec]:
            raise ValueError(f"the crf of h264 and hevc is at most {MAX_CRF[codec]}")
        return value

    @field_validator("matte")
    @classmethod
    def _asked_for(cls, matte: MatteFormat, info: ValidationInfo) -> MatteFormat:
        if matte != "ffv1" and "matte" not in info.data.get("extras", ["matte"]):
            raise ValueError(f'{matte} is of the matte; ask for it: "extras": ["matte"]')
        return matte


class TransferRequest(Request):
    """Colours of one or more references on one video."""

    video: MediaId
    looks: list[LookRequest] = Field(min_length=1, max_length=MAX_LOOKS)
    output: OutputRequest = OutputRequest()
    webhook: WebhookRequest | None = None
    metadata: Metadata = Field(default={})
    force: Force = False


class SwapRequest(_ColorOptions):
    """``a`` with the colours of ``b``, then ``b`` with those of ``a``; without ``b``, two ``faces`` exchange theirs."""

    a: MediaId
    b: MediaId | None = Field(default=None, description="another video; without it, two faces of `a` are exchanged")
    contrast: Contrast | ContrastOfEach = Field(
        default="auto", description="contrast of the skin: 0.7–1.5, or auto; for both sides, or for each"
    )
    output: OutputRequest = OutputRequest()
    webhook: WebhookRequest | None = None
    metadata: Metadata = Field(default={})
    force: Force = False

    @property
    def contrasts(self) -> tuple[Contrast, Contrast]:
        """The contrast of either side."""
        if isinstance(self.contrast, list):
            return self.contrast[0], self.contrast[1]
        return self.contrast, self.contrast

    def side(self, contrast: Contrast) -> LookOptions:
        """The options of one side."""
        return LookOptions(**{name: getattr(self, name) for name in _ColorOptions.model_fields}, contrast=contrast)
