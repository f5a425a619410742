"""The errors this library raises on purpose; anything else that escapes is a bug."""

from __future__ import annotations


class PvgError(Exception):
    """Base of every deliberate error. The message says what, where and what to do, in one line."""


class MediaError(PvgError):
    """The input is not a video or image this library reads, is damaged, or breaks a limit."""


class PartError(MediaError):
    """A part of a clip is missing, damaged, or of another clip, place or manner: it has to be drawn again."""


class NoFaceError(PvgError):
    """No usable face was found in the input."""


class FaceTooSmallError(NoFaceError):
    """Faces were found, but all of them are smaller than the method can work with."""


class ModelError(PvgError):
    """A network weight file is missing or is not the pinned one."""


class AssetError(PvgError):
    """An asset file is truncated, altered, of another version, or belongs to another clip."""


class SolverError(PvgError):
    """A linear solve is singular or missed its tolerance."""


class UncutError(SolverError):
    """No curve crosses the region of a membrane, so that nothing tells its values."""
