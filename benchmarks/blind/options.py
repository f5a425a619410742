"""What commands that draw sheets are told alike: which clips and portraits, and where to."""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.quality.media import HALVES, Half, choose, find_material, half_of, usable_portraits
from scripts.samples import REPOSITORY


def add_material(parser: argparse.ArgumentParser, *, half: Half, seed_of: str, folder: str) -> None:
    """The options of a command whose sheets go to a `folder` of benchmarks/out.

    half: the default;  seed_of: what follows from the seed, in words.
    """
    parser.add_argument("--half", choices=HALVES, default=half, help="every second clip and portrait, or all")
    parser.add_argument("--seed", type=int, default=0, help=f"of {seed_of}")
    parser.add_argument("--clips", help="comma-separated parts of clip names, of that half")
    parser.add_argument("--clips-in", type=Path, help="a folder of other clips or pictures, all of which are taken")
    parser.add_argument("--out", type=Path, default=REPOSITORY / "benchmarks" / "out" / folder, help="folder")
    parser.add_argument("--assets", type=Path, help="folder that keeps the assets of ours for the next set of sheets")


def material_of(options: argparse.Namespace) -> tuple[tuple[Path, ...], tuple[Path, ...]]:
    """The clips and portraits that the options name."""
    material = find_material()
    clips = half_of(sorted(material.clips), options.half)
    if options.clips_in is not None:
        clips = tuple(sorted(path for path in options.clips_in.iterdir() if path.is_file()))
    clips = choose(clips, options.clips)
    return clips, half_of(usable_portraits(material.portraits), options.half)


def emptied(folder: Path) -> Path:
    """A folder without the sheets of before, made where it is missing."""
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("*.png"):
        old.unlink()
    return folder
