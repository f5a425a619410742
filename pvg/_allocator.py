"""Memory that was freed and that the C library keeps: glibc, whose allocator gives back little by itself."""

from __future__ import annotations

import ctypes
import gc
from collections.abc import Callable
from functools import cache


def give_back() -> None:
    """Give the system what this process has freed, cycles of objects too; where there is no glibc only these are freed.

    Once a large block was freed, glibc takes further ones of up to 32 MB from its heap, where small ones that are still
    needed keep all before them. It takes some 50 ms, and whoever goes on has pages handed out anew.
    """
    gc.collect()
    trim = _trim()
    if trim is not None:
        trim(0)


@cache
def _trim() -> Callable[[int], int] | None:
    try:
        trim = ctypes.CDLL(None).malloc_trim
    except (OSError, TypeError, AttributeError):  # another C library; Windows
        return None
    trim.argtypes, trim.restype = [ctypes.c_size_t], ctypes.c_int
    return trim  # type: ignore[no-any-return]
