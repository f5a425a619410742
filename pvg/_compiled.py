"""The one decorator of the compiled functions: numba, with its cache on disk and without the interpreter's lock."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(*, fastmath: bool = False, inline: bool = False) -> Callable[[Function], Function]:
    """Compile a function for the types of its first call and keep the machine code for the next process.

    fastmath: the numbers are finite and sums may be reordered, which lets sums and maxima use vector registers;
    inline: merge the function into the kernels that call it. The decorated function keeps its declared types.
    """
    options: dict[str, Any] = {"nogil": True}
    if fastmath:
        options["fastmath"] = True
    if inline:
        options["inline"] = "always"  # its code lies in its callers' cache
    else:
        options["cache"] = True

    def compiled(function: Function) -> Function:
        return cast("Function", njit(**options)(function))

    return compiled
