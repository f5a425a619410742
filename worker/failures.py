"""What went wrong, as the problem that is shown. Internals stay in the log."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any, Final

from service.catalog import Media
from service.errors import Limit, stored_problem
from service.outages import is_disk_full, is_outage
from worker.answers import one_line
from worker.sandbox import (
    CrashError,
    FileLimitError,
    LimitError,
    MemoryLimitError,
    MethodError,
    NoRoomError,
    TimeLimitError,
    with_causes,
)


class SourceLostError(Exception):
    """The storage does not have the file of a medium any more."""

    def __init__(self, media_id: str) -> None:
        super().__init__(f"the file of {media_id} is no longer in the storage; upload it again")


class AssetLostError(Exception):
    """The storage does not have the asset of a medium any more, and it is not made again here."""

    def __init__(self, media_id: str) -> None:
        super().__init__(f"the vectorised {media_id} is no longer in the storage; a transfer with it makes it again")


class LostAssetsError(Exception):
    """Assets are missing, damaged or of another version: their blobs' keys as they were found, by medium."""

    def __init__(self, assets: Mapping[str, str | None]) -> None:
        super().__init__(f"the vectorised {', '.join(sorted(assets))} cannot be read, though made again")
        self.assets = assets


class UnreadyError(Exception):
    """These media of a job are being vectorised, or were since its first part was begun: it has to begin anew."""

    def __init__(self, media_ids: Collection[str]) -> None:
        super().__init__(f"{', '.join(sorted(media_ids))} is being vectorised again")
        self.media_ids = media_ids


class LostPartsError(Exception):
    """Parts that were drawn are missing, damaged or of another version when they are to be joined."""


class OptionError(Exception):
    """An option of the request does not fit the medium it is used on. ``pointer`` says where in the request it is."""

    def __init__(self, detail: str, pointer: str | None = None) -> None:
        super().__init__(detail)
        self.errors = [] if pointer is None else [{"pointer": pointer, "detail": detail}]


#: the problems of errors that tell of the input, by the names of their classes in the job's process
EXPECTED: Final = {
    "FaceTooSmallError": "face-too-small",
    "NoFaceError": "no-face",
    "MediaError": "media-invalid",
    "AssetError": "asset-invalid",
    "OptionError": "validation-failed",
    "AbsentFaceError": "validation-failed",
    "TooLongError": "too-long",
    "TooLargeError": "too-large",
}
#: where the request of a picture has what such an error is about
_PLACES: Final = {"AbsentFaceError": "/face"}
#: those of our own errors whose text is shown
_SHOWN: Final[dict[type[Exception], str]] = {
    OptionError: "validation-failed",
    SourceLostError: "source-lost",
    AssetLostError: "asset-invalid",
    LostAssetsError: "asset-invalid",
    TimeLimitError: "time-limit",
    MemoryLimitError: "too-large",
    FileLimitError: "too-large",
}
_CRASHED: Final = "the job ended its process on every attempt"


def problem_of(error: Exception) -> dict[str, Any]:
    """The problem to store with the job."""
    if type(error) in _SHOWN:
        errors = error.errors if isinstance(error, OptionError) else ()
        return stored_problem(_SHOWN[type(error)], str(error), errors, _limit_of(error))
    if isinstance(error, MethodError) and error.kind in EXPECTED:
        detail = one_line(str(error))
        errors = [{"pointer": _PLACES[error.kind], "detail": detail}] if error.kind in _PLACES else []
        return stored_problem(EXPECTED[error.kind], detail, errors, _limit_of(error))
    if isinstance(error, CrashError):
        return stored_problem("worker-crashed", _CRASHED)
    if lacks_room(error):
        return stored_problem("insufficient-storage", "no room was left for this job, on every attempt")
    if is_outage(error) or isinstance(error, OSError):  # of no medium: those are of the method
        return stored_problem("unavailable", "the records or the files could not be reached for too long")
    return stored_problem("internal-error", "the job failed on our side; the log has it under this job's id")


def _limit_of(error: Exception) -> Limit | None:
    if isinstance(error, MethodError | LimitError) and error.limit is not None:
        return Limit(*error.limit)
    return None


def problem_of_picture(error: Exception) -> dict[str, Any]:
    """The problem to store with a preview. A crash, a timeout and a disk's error are temporary here."""
    if isinstance(error, TimeLimitError):
        return stored_problem("unavailable", "the picture was not made in time; try again")
    if isinstance(error, CrashError):
        return stored_problem("unavailable", "the process that made the picture has ended; try again")
    if isinstance(error, MethodError) and error.fault:  # a medium that was vectorised is whole
        return stored_problem("unavailable", "the files could not be reached; try again")
    return problem_of(error)


def is_expected(error: Exception) -> bool:
    """True for errors that tell of the input, not of a fault of ours."""
    if isinstance(error, MethodError):
        return error.kind in EXPECTED and error.fault is None
    return isinstance(error, OptionError | SourceLostError | AssetLostError | LimitError)


def lacks_room(error: BaseException) -> bool:
    """True when an error, or one that led to it, is that of a full disk."""
    return any(isinstance(one, NoRoomError) or is_disk_full(one) for one in with_causes(error))


def without_files(error: MethodError, media: Iterable[Media], keys: Mapping[Path, str]) -> MethodError:
    """The same error, with these media in place of their files: clients know neither blobs nor folders.

    ``keys`` are those of the blobs, by their local files.
    """
    names: dict[str, str] = {}
    for medium in media:
        names[medium.source_key] = medium.id
        if medium.asset_key is not None:
            names[medium.asset_key] = f"the vectorised {medium.id}"
    return error.saying(without_paths(str(error), {path: names.get(key, "a file") for path, key in keys.items()}))


def without_paths(text: str, names: Mapping[Path, str]) -> str:
    """A text with these names in place of their files, with the folders that they are in."""
    for path, name in names.items():
        for whole in (path.resolve(), path.absolute(), path):
            text = text.replace(str(whole), name)
        text = re.sub(rf"(?<![^\s'\"])[^\s'\"]*{re.escape(path.name)}", name, text)
    return text
