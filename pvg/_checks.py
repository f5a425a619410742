"""Options of the library, looked at where they come in: numbers of any kind, NumPy's too, and words."""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import suppress
from numbers import Integral, Real


def real_number(name: str, value: object, low: float, high: float) -> float:
    """The option as a number in [low, high]. Raises ValueError."""
    number = math.nan
    if isinstance(value, Real) and not isinstance(value, bool):
        with suppress(OverflowError):  # of whole numbers
            number = float(value)
    if not low <= number <= high:
        raise ValueError(f"{name} must be a number from {low:g} to {high:g}, not {value!r}")
    return number


def whole_number(name: str, value: object, low: int | None = 0, high: int | None = None) -> int:
    """The option as a whole number, from `low` on or any, up to `high` or any. Raises ValueError."""
    if isinstance(value, Integral) and not isinstance(value, bool):
        whole = int(value)
        if (low is None or low <= whole) and (high is None or whole <= high):
            return whole
    bounds = ("" if low is None else f" from {low}") + ("" if high is None else f" to {high}")
    raise ValueError(f"{name} must be a whole number{bounds}, not {value!r}")


def check_word(name: str, value: object, known: Iterable[str]) -> None:
    """Raise ValueError unless the option is one of the words that are `known`."""
    known = tuple(known)
    if not isinstance(value, str) or value not in known:
        raise ValueError(f"{name} must be one of {', '.join(known)}, not {value!r}")


def check_switch(name: str, value: object) -> None:
    """Raise ValueError unless the option is True or False."""
    if not isinstance(value, bool):
        raise ValueError(f"{name} must be True or False, not {value!r}")
