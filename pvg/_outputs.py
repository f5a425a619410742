"""Where a command may write: told before the long work begins, as far as it can be.

A name that does not fit is a ValueError, a place that cannot be written an OSError.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pvg._targets import STANDARD, check_file, check_folder

if TYPE_CHECKING:
    from pvg.asset import VectorVideo

# as `pvg.video` and `_options` have them: what these would load takes long, and a refusal is to be quick
IMAGES = ("png", "tiff", "jpg", "webp")
PIPED = ("nut", "y4m")
NAMED_AS_FILES = (
    *(".mp4", ".m4v", ".mov", ".mkv", ".webm"),
    *(".png", ".tif", ".tiff", ".jpg", ".jpeg", ".webp"),
    ".pvg",
)


def kind_of(path: Path) -> Literal["video", "image"]:
    """Whether a file is a clip or a picture, told by its first bytes. Raises MediaError where it is neither."""
    from pvg.video import IMAGE_KINDS, sniff  # noqa: PLC0415 - takes long, and the work needs it anyway

    return "image" if sniff(path) in IMAGE_KINDS else "video"


def check_suffix(path: Path, kinds: Iterable[str]) -> None:
    """Refuse a name that does not end as pictures or clips of these kinds do."""
    from pvg.video import CLIP_SUFFIXES, IMAGE_SUFFIXES  # noqa: PLC0415 - takes long, and the work needs it anyway

    suffixes = {"video": CLIP_SUFFIXES, "image": IMAGE_SUFFIXES}
    allowed = [suffix for kind in kinds for suffix in suffixes[kind]]
    if path.suffix.lower() not in allowed:
        raise ValueError(f"-o {path} must end in {', '.join(allowed)}")


def check_asset_name(path: Path) -> None:
    """Refuse a name by which an asset would be taken for a clip or a picture."""
    from pvg.video import CLIP_SUFFIXES, IMAGE_SUFFIXES  # noqa: PLC0415 - takes long, and the work needs it anyway

    if path.suffix.lower() in (*CLIP_SUFFIXES, *IMAGE_SUFFIXES):
        raise ValueError(f"{path.name} is the name of a clip or picture; an asset is named as clip.pvg")


def suffix(kind: str, container: str | None = None) -> str:
    """Of an output that is named by the command;  kind: "video" or "image", of what is drawn on."""
    is_image = kind == "image"
    if container is None:
        return ".png" if is_image else ".mp4"
    if (container in IMAGES) != is_image:
        raise ValueError(f"{container} does not fit {'an image' if is_image else 'a clip'}")
    return f".{container}"


def check_coding(path: Path, kind: str, output: Path | None, asked: Mapping[str, Any], **reading: Any) -> None:
    """Refuse, before the long work, what a clip or picture at `path` cannot be written as.

    kind: "video" or "image";  output: the one file or pipe, None where the command names files;  asked: the options of
    outputs, as `pvg.render` takes them;  reading: those of `pvg.video.probe`. Raises MediaError as that.
    """
    from pvg.video import check_scales, planned  # noqa: PLC0415 - takes long, and the work needs it anyway

    ending = suffix(kind, asked["container"])
    if output == STANDARD:
        if kind == "image":
            raise ValueError("a picture is written to a file, not to a pipe")
        ending = asked["container"] or "nut"
    elif output is not None:
        check_suffix(output, [kind])
        ending = output.suffix.lower()
    if kind == "video":
        plan = planned(path, container=ending, codec=asked["codec"], audio=asked["audio"], **reading)
        check_scales(plan.codec, asked["crf"], asked["preset"])


def check_pipe(container: str | None, references: list[Path]) -> None:
    """What can be told of an output to a pipe before the clip is known."""
    if len(references) > 1:
        raise ValueError("-o - is one stream; several references need a folder")
    if container not in (None, *PIPED):
        raise ValueError(f"{container} cannot be written to a pipe; --container {' and '.join(PIPED)} can")


def check_results_folder(output: Path, results: str) -> None:
    """Refuse a folder for these results, in words, that is a stream, a file or named as one, or that cannot be made."""
    if output == STANDARD:
        raise ValueError(f"-o {output} is a stream; {results} need a folder")
    if output.exists() and not output.is_dir():
        raise ValueError(f"-o {output} is a file; {results} need a folder")
    if output.suffix.lower() in NAMED_AS_FILES and not output.is_dir():
        raise ValueError(f"-o {output} is named as a file is; {results} need a folder")
    check_folder(output)


def check_outputs(
    output: Path, references: list[Path], inputs: list[Path | None], container: str | None = None
) -> None:
    """What can be told of the outputs before the clip is known."""
    if container in PIPED:
        raise ValueError(f"{container} is written to a pipe: -o -")
    if container is not None and output.suffix and not output.is_dir() and len(references) == 1:
        named = {".m4v": "mp4", ".jpeg": "jpg", ".tif": "tiff"}.get(output.suffix.lower(), output.suffix.lower()[1:])
        if named != container:
            raise ValueError(f"-o {output} is not named as {container} is")
    if len(references) > 1 or output.is_dir():
        check_results_folder(output, "several references")
    else:
        check_suffix(output, ["video", "image"])
        check_file(output, inputs)


def outputs(output: Path, references: list[Path], video: VectorVideo, container: str | None = None) -> list[Path]:
    """The file of each look."""
    ending = suffix(video.media.kind, container)
    if len(references) == 1:
        return [output / f"{references[0].stem}{ending}" if output.is_dir() else output]
    output.mkdir(parents=True, exist_ok=True)
    return [output / f"{name}{ending}" for name in _told_apart([path.stem for path in references])]


def _told_apart(stems: list[str]) -> list[str]:
    """The stems; of those that occur twice each with its place, as often as it takes to be no other name."""
    names, taken = list[str](), set(stems)
    for k, stem in enumerate(stems, 1):
        name = stem
        while stems.count(stem) > 1 and name in taken:
            name += f"-{k}"
        names.append(name)
        taken.add(name)
    return names
