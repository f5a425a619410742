"""What a job is asked to do, typed: shared by the API, which records it, and the worker, which does it.

The JSON columns `Job.request` and `Look.params` are written and read here and nowhere else. A value that a former
version did not write reads as its default, and one that this version does not know is passed over.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Final, Literal, TypeVar

from service.catalog.models import Job, Look, Media, Preview, ResumableUpload, Role

Container = Literal["mp4", "mov", "mkv", "webm", "png", "jpg", "webp", "tiff"]
Codec = Literal["auto", "h264", "hevc", "vp9", "av1", "prores", "prores4444", "dnxhr", "ffv1"]
Preset = Literal["ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow", "slower", "veryslow"]
Audio = Literal["copy", "none"]
Extra = Literal["cube", "matte"]
MatteFormat = Literal["ffv1", "prores"]
Match = Literal["color", "semantic"]
Extent = Literal["skin", "face"]
Feature = Literal["eyes", "teeth"]
Mask = Literal["landmarks", "ycbcr"]
Matching = Literal["table", "chain"]
InputColor = Literal["auto", "sdr", "pq", "hlg", "slog3", "logc3", "logc4", "vlog", "applelog"]
Contrast = float | Literal["auto"]
Layer = Literal["image", "landmarks", "mask", "matte", "curves", "low", "high"]
StillFormat = Literal["jpeg", "png"]

#: the containers of clips, and those of a still picture
CLIP_CONTAINERS: Final[tuple[Container, ...]] = ("mp4", "mov", "mkv", "webm")
IMAGE_CONTAINERS: Final[tuple[Container, ...]] = ("png", "jpg", "webp", "tiff")
#: the codecs that each container of clips holds
HELD: Final[dict[str, tuple[Codec, ...]]] = {
    "mp4": ("h264", "hevc", "vp9", "av1"),
    "mov": ("h264", "hevc", "prores", "prores4444", "dnxhr"),
    "mkv": ("h264", "hevc", "vp9", "av1", "ffv1", "prores", "prores4444"),
    "webm": ("vp9", "av1"),
}
#: the codecs with a scale of quality, ``crf``, and where it ends; they alone have ``preset``
MAX_CRF: Final[dict[str, int]] = {"h264": 51, "hevc": 51, "vp9": 63, "av1": 63}
#: how far a part takes the reference's make-up unless it is asked for another share
MAKEUP: Final = 0.75


@dataclass(frozen=True)
class VectorSettings:
    """How a medium is vectorised: how its skin is found, how colours are carried from frame to frame, how it is coded.

    "ycbcr" and "chain" are the paper's; "auto" believes the file's colour tags. The same bytes with other settings
    are another medium.
    """

    mask: Mask = "landmarks"
    matching: Matching = "table"
    input_color: InputColor = "auto"


DEFAULT_VECTOR_SETTINGS: Final = VectorSettings()


@dataclass(frozen=True)
class VectorizeRequest:
    """Vectorise a medium for this role."""

    role: Role
    settings: VectorSettings = DEFAULT_VECTOR_SETTINGS


@dataclass(frozen=True)
class LookParams:
    """How a reference's colours are put on a face.

    ``strength`` is in [0, 1], ``contrast`` in [0.7, 1.5] or "auto"; ``protect`` names the features that go their own
    way, ``faces`` the indices of the faces to change, ``reference_face`` that of the reference's, None its largest;
    ``makeup`` is in [0, 1] for all parts or by part, ``light`` and ``scene`` in [0, 1]; ``extent`` is all skin of the
    person or the face alone;
    ``beta``, ``iterations`` and ``seed`` are those of the transport. With ``exchange`` the two ``faces`` exchange their
    colours, and ``contrast`` has one value for each.
    """

    strength: float = 1.0
    contrast: Contrast | tuple[Contrast, Contrast] = "auto"
    match: Match = "semantic"
    protect: tuple[Feature, ...] = ("eyes", "teeth")
    faces: tuple[int, ...] | Literal["all"] = "all"
    makeup: float | dict[str, float] = MAKEUP
    light: float = 0.0
    scene: float = 1.0
    extent: Extent = "skin"
    reference_face: int | None = None
    beta: float = 0.2
    iterations: int = 20
    seed: int = 0
    exchange: bool = False


@dataclass(frozen=True)
class OutputOptions:
    """How results are encoded. ``crf`` and ``preset`` are the encoder's own scales; None leaves its default.

    Without a ``container``, clips become mp4 and pictures png. ``extras`` are made of each look beside its result: its
    cube, and its matte, coded as ``matte`` says; that of a picture is a png.
    """

    container: Container | None = None
    codec: Codec = "auto"
    crf: int | None = None
    preset: Preset | None = None
    audio: Audio = "copy"
    extras: tuple[Extra, ...] = ()
    matte: MatteFormat = "ffv1"


@dataclass(frozen=True)
class RenderRequest:
    """Render the looks of a transfer or a swap with these options."""

    output: OutputOptions = OutputOptions()


@dataclass(frozen=True)
class StillRequest:
    """A single picture of a medium: a frame with a look, as it is, or a layer of it.

    ``frame`` counts from 0, ``time_s`` from the first one; without either the worker chooses one that shows the faces.
    With ``nearest`` it may be the nearest one that is quick to have. ``params`` are the look's; ``before``: the frame
    without it. ``crop`` is x, y, width, height in pixels, ``face`` a face to show alone; ``max_width`` is in pixels.
    """

    format: StillFormat
    max_width: int
    frame: int | None = None
    time_s: float | None = None
    nearest: bool = False
    params: LookParams | None = None
    before: bool = False
    layer: Layer | None = None
    crop: tuple[int, int, int, int] | None = None
    face: int | None = None


Request = VectorizeRequest | RenderRequest | StillRequest

_Stored = TypeVar("_Stored", LookParams, OutputOptions, StillRequest, VectorSettings)


def to_json(value: Request | LookParams) -> dict[str, Any]:
    """What the column keeps."""
    return {name: list(item) if isinstance(item, tuple) else item for name, item in asdict(value).items()}


def vector_settings(of: Media | ResumableUpload) -> VectorSettings:
    """How a medium is vectorised, or will be once all of it is there."""
    return VectorSettings(**{one.name: getattr(of, one.name) for one in fields(VectorSettings)})


def vectorize_request(job: Job) -> VectorizeRequest:
    """What a vectorize job is asked to do. Raises `KeyError` or `ValueError` for a record of another kind."""
    settings = _from_json(VectorSettings, job.request.get("settings", {}))
    return VectorizeRequest(Role(job.request["role"]), settings)


def render_request(job: Job) -> RenderRequest:
    """What a transfer or swap job is asked to do."""
    return RenderRequest(_from_json(OutputOptions, job.request.get("output", {})))


def still_request(preview: Preview) -> StillRequest:
    """What a single picture is to show."""
    stored = dict(preview.request)
    params = stored.pop("params", None)
    read = _from_json(StillRequest, stored)
    return read if params is None else replace(read, params=_from_json(LookParams, params))


def look_params(look: Look) -> LookParams:
    """How one output of a job is to look."""
    return _from_json(LookParams, look.params)


def no_face(face: int, count: int, what: str) -> str:
    """What is said of a face that is asked for, where ``what`` has ``count``; the method says the same."""
    has = "no faces" if count == 0 else "face 0 only" if count == 1 else f"faces 0 to {count - 1}"
    return f"no face {face}; {what} has {has}"


def _from_json(kind: type[_Stored], stored: dict[str, Any]) -> _Stored:
    known = {field.name for field in fields(kind)}
    read: dict[str, Any] = {
        name: tuple(item) if isinstance(item, list) else item for name, item in stored.items() if name in known
    }
    return kind(**read)
