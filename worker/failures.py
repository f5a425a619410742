"""What went wrong, as the problem that is shown. Internals stay in the log."""

from __future__ import annotations

from typing import Any

from celery.exceptions import SoftTimeLimitExceeded

from pvg.errors import AssetError, FaceTooSmallError, MediaError, NoFaceError, PvgError
from service.errors import stored_problem


class OptionError(Exception):
    """An option of the request does not fit the medium it is used on."""


#: the first class that fits gives the type; children come before their parents
_TYPES: tuple[tuple[type[Exception], str], ...] = (
    (FaceTooSmallError, "face-too-small"),
    (NoFaceError, "no-face"),
    (MediaError, "media-invalid"),
    (AssetError, "asset-invalid"),
    (OptionError, "validation-failed"),
)


def problem_of(error: Exception) -> dict[str, Any]:
    """The problem to store with the job."""
    if isinstance(error, SoftTimeLimitExceeded):
        return stored_problem("time-limit", "the job took longer than the service allows")
    for kind, name in _TYPES:
        if isinstance(error, kind):
            return stored_problem(name, str(error))
    return stored_problem("internal-error", "the job failed on our side; the log has it under this job's id")


def is_expected(error: Exception) -> bool:
    """True for errors that tell of the input, not of a fault of ours."""
    return isinstance(error, PvgError | OptionError | SoftTimeLimitExceeded)
