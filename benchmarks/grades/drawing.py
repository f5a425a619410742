"""A sheet: the reference, the clip's frame and the result, as full frames and face crops."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

import pvg
from benchmarks.blind.drawing import face_window
from benchmarks.blind.sheets import put, write
from benchmarks.grades.plan import Sheet
from benchmarks.quality.clips import kept_asset, measured_frames, widest
from benchmarks.quality.color import lab
from benchmarks.quality.faces import Floats, Image, Reference, View, read_reference, view_of
from benchmarks.quality.peers import Looks
from pvg.rendering import source_frame

SIZE = (1800, 1200)  # width, height
_NARROW, _WIDE, _FULL = 400, 700, 500  # of the reference's column, of the others, of the row of full frames
_GROUND, _GAP = 128, 6
_FAR_IN_TIME = 0.5  # of the clip, between a control's frame and the one that stands for its reference

Shown = tuple[Image, tuple[slice, slice]]
"""A full frame and where its face is."""


def read_references(portraits: Sequence[Path], assets: Path) -> dict[Path, Reference]:
    """The portraits vectorised; assets are made in, or taken from, a folder."""
    return {path: read_reference(path, kept_asset(path, assets, reference=True)) for path in portraits}


def farthest(clip: Path, references: Mapping[Path, Reference], count: int, assets: Path) -> list[Path]:
    """The references whose skin is farthest from the clip's in CIELAB, medians of the first frame measured.

    A portrait is no reference of its own.
    """
    with pvg.open_asset(kept_asset(clip, assets), clip) as video:
        seen = measured_frames(video, widest(video))
        first = next(iter(seen))
        view = view_of(seen[first], (video.media.width, video.media.height))
        own = _median_skin(source_frame(video, first).rgb(), view)

    def distance(path: Path) -> float:
        reference = references[path]
        return float(np.linalg.norm(_median_skin(reference.rgb, reference.view) - own))

    return sorted((path for path in references if path != clip), key=distance, reverse=True)[:count]


def draw_clip(
    clip: Path, sheets: Sequence[Sheet], place: float, references: Mapping[Path, Reference], assets: Path
) -> Iterator[tuple[Sheet, int, Image]]:
    """Each sheet of a clip with the number of its frame;  place: of the frame, in [0, 1] of those with the face."""
    with pvg.open_asset(kept_asset(clip, assets), clip) as video:
        face = widest(video)
        seen = measured_frames(video, face)
        numbers, size = list(seen), (video.media.width, video.media.height)

        def shown(share: float) -> tuple[int, View]:
            number = numbers[round(share * (len(numbers) - 1))]
            return number, view_of(seen[number], size)

        number, view = shown(place)
        frame = source_frame(video, number)
        there, other = shown((place + _FAR_IN_TIME) % 1.0)
        for sheet in sheets:
            reference = references[sheet.reference]
            look = Looks.of("ours", video, face, [reference]).draw(frame, view)[0].rgb, face_window(view)
            own = frame.rgb(), face_window(view)
            if sheet.control:
                twin = source_frame(video, there).rgb(), face_window(other)
                yield sheet, number, draw_sheet(sheet.number, twin, look, own)
            else:
                portrait = reference.rgb, face_window(reference.view)
                yield sheet, number, draw_sheet(sheet.number, portrait, own, look)


def draw_sheet(number: int, reference: Shown, clip: Shown, result: Shown) -> Image:
    """(1200, 1800, 3): three columns of full frames above crops of the face."""
    sheet = np.full((SIZE[1], SIZE[0], 3), _GROUND, np.uint8)
    x = 0
    for title, (picture, window), width in (
        (f"{number} reference", reference, _NARROW),
        ("clip", clip, _WIDE),
        ("result", result, _WIDE),
    ):
        put(sheet, picture, (x, 0, width - _GAP, _FULL - _GAP))
        put(sheet, picture[window], (x, _FULL, width - _GAP, SIZE[1] - _FULL))
        write(sheet, title, (x + 8, 36))
        x += width
    return sheet


def _median_skin(rgb: Image, view: View) -> Floats:
    """(3,) CIELAB."""
    return lab(np.median(view.crop(rgb)[view.bare], axis=0)).astype(np.float32)
