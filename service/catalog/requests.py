"""What a job is asked to do, typed: shared by the API, which records it, and the worker, which does it.

The JSON columns `Job.request` and `Look.params` are written and read here and nowhere else. A value that a former
version did not write reads as its default, and one that this version does not know is passed over.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any, Literal, TypeVar

from service.catalog.models import Job, Look, Role

Container = Literal["mp4", "mov", "mkv", "webm", "png", "jpg", "webp"]
Codec = Literal["auto", "h264", "hevc", "vp9", "av1"]
Preset = Literal["ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow", "slower", "veryslow"]
Audio = Literal["copy", "none"]
Match = Literal["color", "semantic"]
Part = Literal["eyes", "teeth"]


@dataclass(frozen=True)
class VectorizeRequest:
    """Vectorise a medium for this role."""

    role: Role


@dataclass(frozen=True)
class LookParams:
    """How a reference's colours are put on a face.

    ``strength`` is in [0, 1], ``contrast`` in [0.7, 1.5] or "auto"; ``protect`` names the parts that keep their colour,
    ``faces`` the indices of the faces to change.
    """

    strength: float = 1.0
    contrast: float | Literal["auto"] = "auto"
    match: Match = "semantic"
    protect: tuple[Part, ...] = ("eyes", "teeth")
    faces: tuple[int, ...] | Literal["all"] = "all"


@dataclass(frozen=True)
class OutputOptions:
    """How results are encoded. ``crf`` and ``preset`` are the encoder's own scales; None leaves its default.

    Without a ``container``, clips become mp4 and pictures png.
    """

    container: Container | None = None
    codec: Codec = "auto"
    crf: int | None = None
    preset: Preset | None = None
    audio: Audio = "copy"


@dataclass(frozen=True)
class RenderRequest:
    """Render the looks of a transfer or a swap with these options."""

    output: OutputOptions = OutputOptions()


Request = VectorizeRequest | RenderRequest

_Stored = TypeVar("_Stored", LookParams, OutputOptions)


def to_json(value: Request | LookParams) -> dict[str, Any]:
    """What the column keeps."""
    return {name: list(item) if isinstance(item, tuple) else item for name, item in asdict(value).items()}


def vectorize_request(job: Job) -> VectorizeRequest:
    """What a vectorize job is asked to do. Raises `KeyError` or `ValueError` for a record of another kind."""
    return VectorizeRequest(Role(job.request["role"]))


def render_request(job: Job) -> RenderRequest:
    """What a transfer or swap job is asked to do."""
    return RenderRequest(_from_json(OutputOptions, job.request.get("output", {})))


def look_params(look: Look) -> LookParams:
    """How one output of a job is to look."""
    return _from_json(LookParams, look.params)


def _from_json(kind: type[_Stored], stored: dict[str, Any]) -> _Stored:
    known = {field.name for field in fields(kind)}
    read: dict[str, Any] = {
        name: tuple(item) if isinstance(item, list) else item for name, item in stored.items() if name in known
    }
    return kind(**read)
