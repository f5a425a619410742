"""The `pvg` command. Exit codes: 0 done; 2 bad arguments; 3 bad input, with one line that says what and where."""

from __future__ import annotations

import errno
import json
import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal

import typer
from tqdm import tqdm

import pvg
from pvg.asset import VectorVideo
from pvg.errors import AssetError, PvgError
from pvg.looks import Contrast
from pvg.rendering import LAYERS
from pvg.video import CLIP_SUFFIXES, IMAGE_SUFFIXES, write_image

BAD_ARGUMENTS = 2
BAD_INPUT = 3
_ASSET_MAGIC = b"PK\x03\x04"
_SUFFIXES = {"video": CLIP_SUFFIXES, "image": IMAGE_SUFFIXES}

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Face colour transfer for portrait video: vectorise once, many looks.",
)


class Mask(StrEnum):
    """Ways to find the skin."""

    landmarks = "landmarks"
    ycbcr = "ycbcr"


class Matching(StrEnum):
    """Ways to carry the key frame's colours through the clip."""

    table = "table"
    chain = "chain"


class MatchColors(StrEnum):
    """What is transported to what."""

    color = "color"
    semantic = "semantic"


class Codec(StrEnum):
    """Video codecs of the output."""

    auto = "auto"
    h264 = "h264"
    hevc = "hevc"
    vp9 = "vp9"
    av1 = "av1"


ReferenceOption = Annotated[
    list[Path], typer.Option("--reference", help="Portrait image, video or asset; give it once per look.")
]
ContrastOption = Annotated[str, typer.Option(help='"auto" or a factor from 0.7 to 1.5.')]
StrengthOption = Annotated[float, typer.Option(min=0.0, max=1.0, help="0 leaves the clip as it is.")]
MatchOption = Annotated[MatchColors, typer.Option(help="All colours together, or skin to skin, lips to lips.")]
CodecOption = Annotated[Codec, typer.Option(help="Video codec of the output.")]


@contextmanager
def _progress() -> Iterator[Callable[[str, int, int], None]]:
    """A progress callback that draws one bar a stage on a terminal and nothing when piped."""
    bars: dict[str, tqdm[None]] = {}

    def report(stage: str, done: int, total: int) -> None:
        if stage not in bars:
            for bar in bars.values():
                bar.close()
            bars[stage] = tqdm(desc=stage, total=total or None, unit="frame", disable=not sys.stderr.isatty())
        bars[stage].update(done - bars[stage].n)

    try:
        yield report
    finally:
        for bar in bars.values():
            bar.close()


def _is_asset(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(4) == _ASSET_MAGIC
    except OSError:
        return False


def _open_input(path: Path, stack: ExitStack, *, reference: bool, source: Path | None = None) -> VectorVideo:
    """An asset as it is; a clip or image is vectorised into a temporary asset."""
    if _is_asset(path):
        opened = stack.enter_context(pvg.open_asset(path, source or _source_beside(path)))
        if not reference and opened.source is None:
            name = opened.manifest.get("source_name", "the clip")
            raise AssetError(
                f"{path.name} is drawn on {name}, which it was made from: put that beside it or say --source"
            )
        return opened
    with _progress() as progress:
        return stack.enter_context(pvg.vectorize(path, reference=reference, progress=progress))


def _source_beside(asset: Path) -> Path | None:
    """The clip an asset was made from, when it stands beside it under the name `pvg vectorize` noted."""
    with pvg.open_asset(asset) as video:
        name = video.manifest.get("source_name")
    found = asset.parent / str(name)
    return found if name and found.is_file() else None


def _contrast(value: str) -> Contrast:
    if value == "auto":
        return "auto"
    try:
        factor = float(value)
    except ValueError:
        factor = math.nan
    if not 0.7 <= factor <= 1.5:
        raise typer.BadParameter(f'"auto" or a number from 0.7 to 1.5, not {value!r}', param_hint="--contrast")
    return factor


def _face(value: str) -> Literal["all"] | list[int]:
    if value == "all":
        return "all"
    try:
        return [int(part) for part in value.split(",")]
    except ValueError:
        raise typer.BadParameter(f'"all" or face numbers like 0 or 0,1, not {value!r}', param_hint="--face") from None


def _check_file(path: Path, inputs: Iterable[Path | None]) -> None:
    """Refuse, before the long work, a file that cannot be written or would replace what is being read."""
    if path.is_dir():
        raise _os_error(errno.EISDIR, path)
    if path.exists():
        if not path.is_file():
            raise typer.BadParameter(f"{path} is not a regular file", param_hint="-o")
        if any(other is not None and other.exists() and path.samefile(other) for other in inputs):
            raise typer.BadParameter(f"{path} is read by this command; write to another name", param_hint="-o")
    if not path.parent.exists():
        raise _os_error(errno.ENOENT, path.parent)
    _check_folder(path.parent)


def _check_folder(path: Path) -> None:
    """Refuse a folder that cannot be made or written to."""
    found = next(one for one in (path, *path.absolute().parents) if one.exists())
    if not found.is_dir():
        raise _os_error(errno.ENOTDIR, found)
    if not os.access(found, os.W_OK | os.X_OK):
        raise _os_error(errno.EACCES, found)


def _os_error(number: int, path: Path) -> OSError:
    return OSError(number, os.strerror(number), str(path))


def _check_suffix(path: Path, kinds: Iterable[str]) -> None:
    allowed = [suffix for kind in kinds for suffix in _SUFFIXES[kind]]
    if path.suffix.lower() not in allowed:
        raise typer.BadParameter(f"{path} must end in {', '.join(allowed)}", param_hint="-o")


@app.command()
def vectorize(
    source: Annotated[Path, typer.Argument(metavar="INPUT", help="Clip or image.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="ASSET", help="Asset file to write.")],
    mask: Annotated[Mask, typer.Option(help="How the skin is found; ycbcr is the paper's rule.")] = Mask.landmarks,
    matching: Annotated[Matching, typer.Option(help="How colours are carried; chain is the paper's.")] = Matching.table,
) -> None:
    """Vectorise a clip or an image into an asset file."""
    _check_file(output, [source])
    with _progress() as progress:
        pvg.vectorize(source, asset=output, mask=mask.value, matching=matching.value, progress=progress).close()
    typer.echo(output)


@app.command()
def transfer(
    video: Annotated[Path, typer.Argument(metavar="ASSET|CLIP|IMAGE")],
    reference: ReferenceOption,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="OUT", help="A file for one reference, a folder for several.")
    ],
    contrast: ContrastOption = "auto",
    strength: StrengthOption = 1.0,
    match: MatchOption = MatchColors.semantic,
    face: Annotated[str, typer.Option(help='"all" or face numbers, e.g. 0 or 0,1.')] = "all",
    source: Annotated[Path | None, typer.Option(help="The clip an ASSET was made from, if not beside it.")] = None,
    codec: CodecOption = Codec.auto,
) -> None:
    """Give the faces of a clip the face colours of one or more references."""
    factor, faces = _contrast(contrast), _face(face)
    _check_outputs(output, reference, [video, source, *reference])
    with ExitStack() as stack:
        clip = _open_input(video, stack, reference=False, source=source)
        looks = [
            pvg.transfer(
                clip,
                _open_input(path, stack, reference=True),
                contrast=factor,
                strength=strength,
                match=match.value,
                faces=faces,
            )
            for path in reference
        ]
        outputs = _outputs(output, reference, clip)
        for path in outputs:
            _check_suffix(path, [clip.media.kind])
            _check_file(path, [clip.source, video, *reference])
        with _progress() as progress:
            pvg.render(clip, looks, outputs, codec=codec.value, progress=progress)
    for path in outputs:
        typer.echo(path)


def _suffix(video: VectorVideo) -> str:
    return ".png" if video.media.kind == "image" else ".mp4"


def _check_outputs(output: Path, references: list[Path], inputs: list[Path | None]) -> None:
    """What can be told of the outputs before the clip is known."""
    if len(references) > 1 and output.suffix and not output.is_dir():
        raise typer.BadParameter(f"several references need a folder, not the file {output}", param_hint="-o")
    if len(references) > 1 or output.is_dir():
        _check_folder(output)
    else:
        _check_suffix(output, _SUFFIXES)
        _check_file(output, inputs)


def _outputs(output: Path, references: list[Path], video: VectorVideo) -> list[Path]:
    if len(references) == 1:
        return [output / f"{references[0].stem}{_suffix(video)}" if output.is_dir() else output]
    output.mkdir(parents=True, exist_ok=True)
    stems = [path.stem for path in references]
    names = [stem if stems.count(stem) == 1 else f"{stem}-{k + 1}" for k, stem in enumerate(stems)]
    return [output / f"{name}{_suffix(video)}" for name in names]


@app.command()
def swap(
    a: Annotated[Path, typer.Argument(metavar="A")],
    b: Annotated[Path, typer.Argument(metavar="B")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FOLDER")],
    contrast: ContrastOption = "auto",
    strength: StrengthOption = 1.0,
    match: MatchOption = MatchColors.semantic,
    codec: CodecOption = Codec.auto,
) -> None:
    """Exchange the face colours of two clips or images."""
    factor = _contrast(contrast)
    _check_folder(output)
    with ExitStack() as stack:
        first, second = _open_input(a, stack, reference=False), _open_input(b, stack, reference=False)
        same = a.stem == b.stem
        outputs = [
            output / f"{a.stem}{'-a' if same else ''}{_suffix(first)}",
            output / f"{b.stem}{'-b' if same else ''}{_suffix(second)}",
        ]
        output.mkdir(parents=True, exist_ok=True)
        for path in outputs:
            _check_file(path, [a, b, first.source, second.source])
        with _progress() as progress:
            pvg.swap(
                first,
                second,
                outputs,
                contrast=factor,
                strength=strength,
                match=match.value,
                codec=codec.value,
                progress=progress,
            )
    for path in outputs:
        typer.echo(path)


@app.command()
def inspect(
    asset: Annotated[Path, typer.Argument(metavar="ASSET")],
    frame: Annotated[int, typer.Option(min=0, help="Frame number, from 0.")] = 0,
    layer: Annotated[str | None, typer.Option(help=" | ".join(LAYERS))] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", metavar="PNG")] = None,
    source: Annotated[Path | None, typer.Option(help="The clip the asset was made from, if not beside it.")] = None,
) -> None:
    """Show what an asset holds: a JSON summary, or a picture of one layer of one frame."""
    if layer is not None and layer not in LAYERS:
        raise typer.BadParameter(f"one of {', '.join(LAYERS)}, not {layer!r}", param_hint="--layer")
    if (layer is None) != (output is None):
        raise typer.BadParameter("--layer and -o go together")
    if output is not None:
        _check_suffix(output, ["image"])
        _check_file(output, [asset, source])
    with pvg.open_asset(asset, source or _source_beside(asset)) as video:
        if layer is None or output is None:
            typer.echo(json.dumps(video.summary(), indent=2))
            return
        if frame >= video.frame_count:
            raise typer.BadParameter(f"the clip has {video.frame_count} frames", param_hint="--frame")
        write_image(output, pvg.layer(video, frame, layer))
    typer.echo(output)


def main() -> None:
    """Run the command and turn the library's errors into exit codes."""
    try:
        app()
    except PvgError as error:
        typer.echo(f"pvg: {error}", err=True)
        sys.exit(BAD_INPUT)
    except OSError as error:
        where = f": {error.filename}" if error.filename is not None else ""
        typer.echo(f"pvg: {error.strerror or error}{where}", err=True)
        sys.exit(BAD_INPUT)
    except ValueError as error:
        typer.echo(f"pvg: {error}", err=True)
        sys.exit(BAD_ARGUMENTS)


if __name__ == "__main__":
    main()
