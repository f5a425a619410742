"""What is measured on: the labelled media beside the repository, else the samples from registry packages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

from scripts.samples import REPOSITORY, fetch_samples

MEDIA = REPOSITORY.parent / "shared" / "media"
HALVES = ("tune", "report", "all")
LEFT_OUT = ("woman_astronaut", "group_")  # a face too small for its skin to be told, and four faces
# pale, tan, brown, and a dim picture: the pairs then go both ways between light and dark
DEFAULT_REFERENCES = (
    "woman_pale_soft_light",
    "man_tan_warm_stage_light",
    "man_brown_skin_glasses_beard_blue_bg",
    "woman_low_key_dark_background",
)

Half = Literal["tune", "report", "all"]
T = TypeVar("T")


@dataclass(frozen=True)
class Material:
    """Files to measure on.

    clips: with a face;  references: portraits for the measures over time;  portraits: all, for the colour measures;
    labelled: (portrait, class labels);  source: where they come from.
    """

    clips: tuple[Path, ...]
    references: tuple[Path, ...]
    portraits: tuple[Path, ...]
    labelled: tuple[tuple[Path, Path], ...]
    source: str


def find_material() -> Material:
    """The media folder when it is there, else the registry samples."""
    if MEDIA.is_dir():
        portraits = tuple(sorted((MEDIA / "portraits").glob("*.jpg")))
        labels = sorted((MEDIA / "masks").glob("*_labels.png"))
        return Material(
            clips=tuple(sorted((MEDIA / "clips").glob("*.mp4"))),
            references=tuple(p for name in DEFAULT_REFERENCES for p in portraits if p.stem == name),
            portraits=portraits,
            labelled=tuple((path.with_name(path.name.replace("_labels.png", ".jpg")), path) for path in labels),
            source="shared/media",
        )
    samples = fetch_samples()
    portraits = (samples.pale_portrait, samples.dark_portrait, samples.portrait)
    return Material((samples.woman_clip, samples.single_face_clip), portraits, portraits, (), "registry samples")


def half_of(items: Sequence[T], half: Half) -> tuple[T, ...]:
    """Every second of sorted items: "tune" from the first on, "report" from the second; "all" of them."""
    return tuple({"tune": items[::2], "report": items[1::2], "all": items}[half])


def usable_portraits(portraits: Sequence[Path]) -> list[Path]:
    """The portraits that halves are taken of, by name."""
    return sorted(path for path in portraits if not path.stem.startswith(LEFT_OUT))


def choose(paths: tuple[Path, ...], wanted: str | None) -> tuple[Path, ...]:
    """The paths whose names hold one of the comma-separated words. Raises `SystemExit` when a word fits none."""
    if not wanted:
        return paths
    chosen: list[Path] = []
    for word in wanted.split(","):
        found = [path for path in paths if word in path.stem]
        if not found:
            raise SystemExit(f"no file is called like {word!r}; there are {', '.join(path.stem for path in paths)}")
        chosen += [path for path in found if path not in chosen]
    return tuple(chosen)
