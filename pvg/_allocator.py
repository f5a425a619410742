"""Memory that was freed and that the C library keeps: glibc, whose allocator gives back little by itself.

Once a block was freed that had been mapped by itself, glibc takes others of that size, up to 32 MB, from its heap,
where small blocks that are still needed keep all that lies before them.
"""

from __future__ import annotations

import ctypes
import gc
import os
from functools import cache
from typing import Final

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of mallopt, as malloc.h has them
_LARGE: Final = 2_000_000  # bytes: the luma of 1920x1080, an encoder's pictures
_KEPT_FREE: Final = 64_000_000  # at the end of the heap: what glibc itself comes to


def give_back() -> None:
    """Give the system what this process has freed, cycles of objects too; where there is no glibc only these are freed.

    It takes some 50 ms, and whoever goes on has pages handed out anew.
    """
    gc.collect()
    library = _glibc()
    if library is not None:
        library.malloc_trim(0)


def map_large_blocks() -> None:
    """From now on blocks of 2 MB and more are mapped each by itself, and gone when they are freed.

    So it stays in this process. Nothing is done where the environment sets such a limit, or where there is no glibc.
    """
    library = _glibc()
    told = "MALLOC_MMAP_THRESHOLD_" in os.environ or "malloc.mmap_threshold" in os.environ.get("GLIBC_TUNABLES", "")
    if library is not None and not told:
        library.mallopt(_MMAP_THRESHOLD, _LARGE)
        library.mallopt(_TRIM_THRESHOLD, _KEPT_FREE)


@cache
def _glibc() -> ctypes.CDLL | None:
    try:
        library = ctypes.CDLL(None)
        library.malloc_trim.argtypes, library.mallopt.argtypes = [ctypes.c_size_t], [ctypes.c_int, ctypes.c_int]
    except (OSError, TypeError, AttributeError):  # another C library; Windows
        return None
    return library
