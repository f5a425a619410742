"""The pictures of the clip that is vectorised: read ahead of who uses them, in any range, with progress."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from pvg._threads import ahead
from pvg.picture import Picture
from pvg.video import Frame, InputColor, MediaInfo, MediaLimits, picture_of, read_frames

Progress = Callable[[str, int, int], None]

_USUAL_RATE = 25.0  # frames a second, of an image


class StoppedByCallerError(Exception):
    """Carries a `StopIteration` that `progress` raised through generators, which would turn it into another error.

    Whatever else `progress` raises passes through them as it is.
    """

    def __init__(self, error: StopIteration) -> None:
        super().__init__(error)
        self.error = error


@dataclass(frozen=True)
class SourceReader:
    """A clip or image and how it is read.

    media: what `probe` says of it;  limits, input_color, strict: see `pvg.vectorize`;
    report: called as (stage, frames done, frames expected);  notices: what reading it told of, a line each.
    """

    path: Path
    media: MediaInfo
    limits: MediaLimits | None
    input_color: InputColor
    strict: bool
    report: Progress
    notices: list[str] = field(default_factory=list)

    @property
    def frame_rate(self) -> float:
        """Frames a second, some usual number for images."""
        return float(self.media.frame_rate or _USUAL_RATE)

    @property
    def is_image(self) -> bool:
        """Whether it is a single picture."""
        return self.media.kind == "image"

    def pictures(
        self, start: int = 0, stop: int | None = None, frame_count: int | None = None
    ) -> Generator[tuple[int, Picture], None, None]:
        """(index, picture) of the frames [start, stop), decoded ahead in a thread.

        frame_count: of the clip, where it has been read to its end.
        """
        reading = self._read(start, stop, frame_count)
        with contextlib.closing(ahead(reading)) as frames:
            for frame in frames:
                yield frame.index, picture_of(frame)

    def reported(
        self, stage: str, start: int = 0, stop: int | None = None, frame_count: int | None = None
    ) -> contextlib.closing[Generator[tuple[int, Picture], None, None]]:
        """`pictures`, with progress, to be taken within a `with` block. They raise `StoppedByCallerError`."""
        return contextlib.closing(self._reported(stage, start, stop, frame_count))

    def _reported(
        self, stage: str, start: int, stop: int | None, frame_count: int | None
    ) -> Generator[tuple[int, Picture], None, None]:
        expected = (self.media.frame_count if stop is None else min(stop, self.media.frame_count)) - start
        with contextlib.closing(self.pictures(start, stop, frame_count)) as pictures:
            for index, picture in pictures:
                yield index, picture
                done = index + 1 - start
                try:
                    self.report(stage, done, max(expected, done))
                except StopIteration as error:
                    raise StoppedByCallerError(error) from error

    def picture(self, index: int, frame_count: int | None) -> Picture:
        """One frame;  frame_count: see `pictures`."""
        (frame,) = self._read(index, index + 1, frame_count)
        return picture_of(frame)

    def _read(self, start: int, stop: int | None, frame_count: int | None) -> Iterator[Frame]:
        return read_frames(
            self.path,
            start=start,
            stop=stop,
            limits=self.limits,
            input_color=self.input_color,
            strict=self.strict,
            frame_count=frame_count,
            notice=self.notices.append,
        )
