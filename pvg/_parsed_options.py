"""Parsed options of the `pvg` command as the library takes them, and checks for those that would have no effect.

Checks raise ValueError. What takes long to load is loaded where it is needed.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pvg._look_options import LOOK_OPTIONS
from pvg._options import OUTPUT_OPTIONS
from pvg._outputs import check_coding, kind_of
from pvg._targets import STANDARD

_ASSET_MAGIC = b"PK\x03\x04"


def is_asset(path: Path) -> bool:
    """Whether a file begins as assets do; False for one that cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(4) == _ASSET_MAGIC
    except OSError:
        return False


def reading_options(given: argparse.Namespace) -> dict[str, Any]:
    """How a clip or picture is read."""
    return {"input_color": given.input_color, "strict": given.strict}


def output_options(given: argparse.Namespace) -> dict[str, Any]:
    """How outputs are encoded."""
    return {name: getattr(given, name) for name in OUTPUT_OPTIONS}


def look_options(given: argparse.Namespace) -> dict[str, Any]:
    """The options of a look that `transfer` and `swap` share, but for the contrast."""
    return {name: getattr(given, name) for name in LOOK_OPTIONS}


def not_default(given: argparse.Namespace, *names: str) -> list[str]:
    """Which of these options of an output were given a value other than the default."""
    return [name for name in names if getattr(given, name, None) not in (None, "auto", "copy")]


def check_inputs(given: argparse.Namespace) -> None:
    """Refuse standard input in the place of a file: what is read is read more than once, and from any place."""
    named = [getattr(given, name, None) for name in ("input", "a", "b", "reference")]
    inputs = [path for one in named for path in (one if isinstance(one, list) else [one])]
    if STANDARD in inputs and not STANDARD.exists():
        raise ValueError("- is standard input; clips, pictures and assets are read from files")


def check_source(given: argparse.Namespace, *, piped: bool = False) -> None:
    """Refuse a source of what is no asset;  piped: whether pictures on standard input are drawn on."""
    if given.source == STANDARD and not piped:
        raise ValueError("--source - is for pictures that `pvg transfer` draws on; name the file of the clip")
    if given.source is not None and given.input.exists() and not is_asset(given.input):
        what = "is for pictures that an asset is drawn on" if given.source == STANDARD else "is an asset's clip"
        raise ValueError(f"--source {given.source} {what}, and {given.input.name} is no asset; give the asset first")


def check_reading(given: argparse.Namespace, *inputs: Path) -> None:
    """Refuse options of reading where all inputs are assets, which were read when they were made."""
    asked = [name for name, value in reading_options(given).items() if value not in ("auto", False)]
    if asked and all(is_asset(path) for path in inputs):
        option = asked[0].replace("_", "-")
        raise ValueError(f"--{option} is of a clip or picture that is read, and {inputs[0].name} is an asset")


def check_codings(given: argparse.Namespace, inputs: Sequence[Path], output: Path | None) -> None:
    """Refuse, before the long work, what these clips and pictures cannot be written as; assets tell it when opened.

    output: the one file or pipe, None where the command names files.
    """
    kinds = {path: kind_of(path) for path in inputs if not is_asset(path)}
    if len(kinds) == len(inputs):
        check_clip_options(given, *kinds.values())
    for path, kind in kinds.items():
        check_coding(path, kind, output, output_options(given), **reading_options(given))


def check_clip_options(given: argparse.Namespace, *kinds: str) -> None:
    """Refuse options of clips where all inputs are pictures;  kinds: "video" or "image", of each input."""
    asked = not_default(given, "codec", "crf", "preset", "audio")
    if asked and all(kind == "image" for kind in kinds):
        raise ValueError(f"--{asked[0]} is of clips, and here are pictures only")
