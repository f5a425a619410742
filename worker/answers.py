"""What a job's process answers, checked: whoever made the medium may have made the answer too.

Sizes and shapes are checked here, and text is cut to one printable line; it is shown as text, never as markup.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from worker.sandbox import CrashError

_MAX_CHARACTERS: Final = 500
_MAX_LINES: Final = 10_000


def one_line(text: str) -> str:
    """The text on one line of bounded length, without control characters."""
    return "".join(letter if letter.isprintable() else " " for letter in text[:_MAX_CHARACTERS])


Line = Annotated[str, AfterValidator(one_line)]
Lines = Annotated[list[Line], Field(max_length=_MAX_LINES)]
Name = Annotated[str, Field(pattern=r"^[\w.,:+ -]{0,60}$")]
Count = Annotated[int, Field(ge=0, le=2**40)]
Size = Annotated[int, Field(ge=1, le=2**20)]
Number = Annotated[float, Field(ge=0, le=2**40)]
Sample = Annotated[int, Field(ge=0, le=255)]


class _Answer(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class MediaAnswer(_Answer):
    """What a file is, see `pvg.asset.MediaSummary`."""

    kind: Literal["video", "image"]
    width: Size
    height: Size
    frame_rate: Number | None
    frame_count: Count
    duration_s: Number
    codec: Name
    pixel_format: Name
    has_audio: bool
    rotation: Count
    color: Name
    color_primaries: Count
    color_transfer: Count
    warnings: Lines


class FaceAnswer(_Answer):
    """One face, see `pvg.asset.FaceSummary`."""

    index: Count
    first_frame: Count
    last_frame: Count
    width_px: Number
    skin_rgb: Annotated[list[Sample], Field(min_length=3, max_length=3)]
    warnings: Lines
    #: where it is seen well; None of faces without a thumbnail
    frame: Count | None
    box: Annotated[list[Count], Field(min_length=4, max_length=4)] | None


class OutputAnswer(_Answer):
    """What a result in a container does not keep of its file, or why there can be none."""

    container: Literal["mp4", "png"]
    refused: Line | None
    lost: Lines


class PictureAnswer(_Answer):
    """Where a small picture is in the file of them, in bytes: the poster, or the thumbnail of a face."""

    face: Count | None
    start: Count
    end: Count


class VectorizeAnswer(_Answer):
    """The answer of `vectorize`."""

    media: MediaAnswer
    pictures: Annotated[list[PictureAnswer], Field(max_length=200)]
    faces: Annotated[list[FaceAnswer], Field(max_length=_MAX_LINES)]
    output: OutputAnswer | None


class ExtraAnswer(_Answer):
    """One file made beside a look."""

    part: Literal["look.cube", "matte"]
    person: Annotated[int, Field(ge=1, le=1000)]
    name: Annotated[str, Field(pattern=r"^(look|matte)(-[0-9]{1,4})?\.(cube|mkv|mov|png)$")]


class LookAnswer(_Answer):
    """One look as it was drawn."""

    mask: Name
    matching: Name
    input_color: Name
    warnings: Lines
    output_warnings: Lines
    extras: Annotated[list[ExtraAnswer], Field(max_length=2000)]


class RenderAnswer(_Answer):
    """The answer of `render`."""

    looks: Annotated[list[LookAnswer], Field(max_length=1000)]
    timings: dict[Literal["transfer_s", "render_s", "extras_s"], Number]


class PartAnswer(_Answer):
    """The answer of `render_part`; ``cpu_s`` is processor time of all its threads."""

    timings: dict[Literal["transfer_s", "render_s", "cpu_s"], Number]


class JoinAnswer(_Answer):
    """The answer of `join`."""

    looks: Annotated[list[LookAnswer], Field(min_length=1, max_length=1)]
    timings: dict[Literal["transfer_s", "join_s", "extras_s", "cpu_s"], Number]


class StillAnswer(_Answer):
    """The answer about a single frame."""

    frame: Count
    width: Size
    height: Size


class VerifyAnswer(_Answer):
    """The answer of `verify`."""

    usable: bool


A = TypeVar("A", bound=_Answer)


def checked(kind: type[A], answer: Any) -> A:
    """The answer as what it must be. Raises `CrashError`: a process that answers so is not ours any more."""
    try:
        return kind.model_validate(answer)
    except ValidationError as error:
        where = ", ".join(".".join(map(str, one["loc"])) for one in error.errors()[:3])
        raise CrashError(f"its process gave an answer that cannot be: {where[:200]}") from None


def made(folder: Path, name: str) -> Path:
    """A file that a job's process has made in its folder. Raises `CrashError` when there is no plain file."""
    path = folder / name
    if folder.is_symlink() or path.is_symlink() or not path.is_file() or path.stat().st_nlink != 1:
        raise CrashError(f"its process made no plain file {name}")
    return path
