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

    So it stays in this process. A limit that the environment sets is left as it is; where it is that of the size, or
    where there is no glibc, nothing is done.
    """
    library = _glibc()
    if library is None or _is_set("mmap_threshold"):
        return
    library.mallopt(_MMAP_THRESHOLD, _LARGE)
    if not _is_set("trim_threshold"):
        library.mallopt(_TRIM_THRESHOLD, _KEPT_FREE)


def _is_set(limit: str) -> bool:
    """Whether the environment sets a limit of glibc's allocator, such as mmap_threshold."""
    return f"MALLOC_{limit.upper()}_" in os.environ or f"malloc.{limit}" in os.environ.get("GLIBC_TUNABLES", "")


@cache
def _glibc() -> ctypes.CDLL | None:
    try:
        library = ctypes.CDLL(None)
        library.malloc_trim.argtypes, library.mallopt.argtypes = [ctypes.c_size_t], [ctypes.c_int, ctypes.c_int]
    except (OSError, TypeError, AttributeError):  # another C library; Windows
        return None
    return library
