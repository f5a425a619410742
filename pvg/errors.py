"""The errors this library raises on purpose; anything else that escapes is a bug."""

from __future__ import annotations

from typing import Any


class PvgError(Exception):
    """Base of every deliberate error. The message says what, where and what to do, in one line."""


class MediaError(PvgError):
    """The input is not a video or image this library reads, is damaged, or breaks a limit."""


class LimitError(MediaError):
    """The input is over a limit of `MediaLimits`: at most `limit` of `unit` are accepted."""

    def __init__(self, message: str, limit: float, unit: str) -> None:
        super().__init__(message)
        self.limit = limit
        self.unit = unit

    def __reduce__(self) -> tuple[Any, ...]:
        # errors pass between processes
        return type(self), (str(self), self.limit, self.unit)


class TooLongError(LimitError):
    """The clip lasts too many `seconds`, or has too many `frames`."""


class TooLargeError(LimitError):
    """It has too many `pixels`, `frames per second` or `streams`, or is a picture of too many `bytes`."""


class PartError(MediaError):
    """A part of a clip is missing, damaged, or of another clip, place or manner: it has to be drawn again."""


class NoFaceError(PvgError):
    """No usable face was found in the input."""


class FaceTooSmallError(NoFaceError):
    """Faces were found, but all of them are smaller than the method can work with."""


class ModelError(PvgError):
    """A network weight file is missing or is not the pinned one."""


class AssetError(PvgError):
    """An asset file is truncated, altered, of another version, without a face, or belongs to another clip."""


class SolverError(PvgError):
    """A linear solve is singular or missed its tolerance."""


class UncutError(SolverError):
    """No curve crosses the region of a membrane, so that nothing tells its values."""
