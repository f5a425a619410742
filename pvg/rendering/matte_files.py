"""Mattes of a clip's persons as files: a grey clip, ProRes with alpha, or pictures; one writer each."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from pvg._arrays import Floats
from pvg.video import Frame, MediaInfo, PixelFormat, VideoWriter, write_image

MatteFormat = Literal["ffv1", "prores", "png"]
MATTES: tuple[MatteFormat, ...] = ("ffv1", "prores", "png")

_GREY = PixelFormat("yuv420p", 8, (1, 1), (0.2126, 0.0722), True)
_WITH_ALPHA = PixelFormat("yuv444p10le", 10, (0, 0), (0.2126, 0.0722), False)
_SUFFIXES: dict[MatteFormat, str] = {"png": "", "prores": ".mov", "ffv1": ".mkv"}


class PictureMatteWriter:
    """Mattes as PNG pictures: one for a picture, a numbered sequence for a clip."""

    def __init__(self, path: Path, *, numbered: bool) -> None:
        self.path, self._numbered = path, numbered

    def __enter__(self) -> PictureMatteWriter:
        if self._numbered:
            self.path.mkdir(exist_ok=True)
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is held."""

    def write(self, frame: Frame, alpha: Floats) -> None:
        """Write the matte of one frame."""
        grey = np.rint(alpha * 255.0).astype(np.uint8)
        path = self.path / f"{frame.index:06d}.png" if self._numbered else self.path
        write_image(path, np.repeat(grey[..., None], 3, axis=-1))


class ClipMatteWriter:
    """Mattes as a clip with the time stamps of the source."""

    def __init__(self, path: Path, info: MediaInfo, pixel_format: PixelFormat, codec: str) -> None:
        self.path, self._format = path, pixel_format
        self._info = replace(
            info,
            format=pixel_format,
            has_audio=False,
            has_alpha=codec == "prores4444",
            color_matrix=1,
            color_primaries=1,
            color_transfer=1,
            color_range=2 if pixel_format.full_range else 1,
        )
        self._writer = VideoWriter(path, self._info, pixel_format, codec=codec)

    def __enter__(self) -> ClipMatteWriter:
        self._writer.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self._writer.__exit__(*error)  # type: ignore[arg-type]

    def write(self, frame: Frame, alpha: Floats) -> None:
        """Write the matte of one frame."""
        planes = self._format.from_rgb(np.repeat(alpha[..., None] * 255.0, 3, axis=-1))
        top = 2**self._format.depth - 1
        full = np.rint(alpha * top).astype(planes[0].dtype) if self._info.has_alpha else None
        drawn = Frame(frame.index, frame.pts, frame.time_s, self._format, planes, frame.duration, alpha=full)
        self._writer.write(drawn)


MatteWriter = PictureMatteWriter | ClipMatteWriter


def matte_name(end: str, matte: MatteFormat, info: MediaInfo) -> str:
    """The name of a person's matte; without a suffix it is a folder of numbered pictures.

    end: what tells the person, as "-2", if there are several.
    """
    return f"matte{end}" + (".png" if info.kind == "image" else _SUFFIXES[matte])


def matte_writer(folder: Path, end: str, matte: MatteFormat, info: MediaInfo) -> MatteWriter:
    """What writes a person's matte into a folder, under its `matte_name`."""
    path = folder / matte_name(end, matte, info)
    if info.kind == "image" or matte == "png":
        return PictureMatteWriter(path, numbered=info.kind != "image")
    if matte == "prores":
        return ClipMatteWriter(path, info, _WITH_ALPHA, "prores4444")
    return ClipMatteWriter(path, info, _GREY, "ffv1")
