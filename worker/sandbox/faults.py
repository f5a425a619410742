"""Errors of the machine under a job, told from those of its media."""

from __future__ import annotations

import errno
from typing import Final, Literal

Fault = Literal["certain", "possible"]

#: what a disk says that is gone, or whose server is (`service.storage` knows the same), or that is only read by now
AWAY: Final = frozenset({errno.EIO, errno.ESTALE, errno.ETIMEDOUT, errno.EHOSTDOWN, errno.ENOTCONN, errno.EROFS})


def with_causes(error: BaseException) -> list[BaseException]:
    """An error, and those that led to it."""
    links: list[BaseException] = []
    one: BaseException | None = error
    while one is not None and one not in links:
        links.append(one)
        one = one.__cause__ or one.__context__
    return links


def fault_of(error: BaseException) -> Fault | None:
    """Whether an error is that of a disk or a shared folder; None when it is not."""
    found = {_fault_of(link) for link in with_causes(error)}
    return "certain" if "certain" in found else "possible" if "possible" in found else None


def _fault_of(error: BaseException) -> Fault | None:
    number = getattr(error, "errno", None)
    if number == errno.ENOENT:  # a file that was there: its folder may not be mounted any more
        return "possible"
    if number == errno.EIO and type(error).__module__.startswith("av."):
        return "possible"  # libav says so of a Matroska file that ends within its header, too
    return "certain" if number in AWAY else None
