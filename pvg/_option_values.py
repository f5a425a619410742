"""Values of the arguments of the `pvg` command, read from text; `ArgumentTypeError` says what would be taken."""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING, Final, Literal

if TYPE_CHECKING:
    from pvg.looks import Contrast

# as the library has them, which takes too long to load for a help text
PARTS: Final = ("lips", "lids", "cheeks", "brows")
PROTECTABLE: Final = ("eyes", "teeth")


def contrast_of(value: str) -> Contrast:
    """ "auto", or a factor from 0.7 to 1.5."""
    if value == "auto":
        return "auto"
    contrast = _number(value)
    if not 0.7 <= contrast <= 1.5:
        raise argparse.ArgumentTypeError(f'"auto" or a number from 0.7 to 1.5, not {value!r}')
    return contrast


def contrasts_of(value: str) -> Contrast | tuple[Contrast, Contrast]:
    """One contrast, or two with a comma between them."""
    parts = value.split(",")
    if len(parts) == 1:
        return contrast_of(value)
    if len(parts) != 2:
        raise argparse.ArgumentTypeError(f"one contrast for both or two like 0.8,1.2, not {value!r}")
    return contrast_of(parts[0]), contrast_of(parts[1])


def share_of(value: str) -> float:
    """A number from 0 to 1."""
    share = _number(value)
    if not 0.0 <= share <= 1.0:
        raise argparse.ArgumentTypeError(f"a number from 0 to 1, not {value!r}")
    return share


def makeup_of(value: str) -> float | dict[str, float]:
    """A share for all parts, or by part as in `lips=1,lids=0.3`."""
    if "=" not in value:
        return share_of(value)
    parts = [part.partition("=")[::2] for part in value.split(",")]
    names = [name for name, _ in parts]
    if unknown := [name for name in names if name not in PARTS or names.count(name) > 1]:
        raise argparse.ArgumentTypeError(f"each of {', '.join(PARTS)} at most once, not {unknown[0]!r}")
    return {name: share_of(share) for name, share in parts}


def protected_of(value: str) -> tuple[str, ...]:
    """Features with commas between them; none for `none`."""
    names = () if value == "none" else tuple(value.split(","))
    if unknown := [name for name in names if name not in PROTECTABLE or names.count(name) > 1]:
        raise argparse.ArgumentTypeError(
            f'"none", or each of {", ".join(PROTECTABLE)} at most once, not {unknown[0]!r}'
        )
    return names


def beta_of(value: str) -> float:
    """A number above 0, up to 1."""
    beta = _number(value)
    if not 0.0 < beta <= 1.0:
        raise argparse.ArgumentTypeError(f"a number above 0, up to 1, not {value!r}")
    return beta


def count_of(value: str) -> int:
    """A whole number from 0."""
    if not value.isdecimal():
        raise argparse.ArgumentTypeError(f"a whole number from 0, not {value!r}")
    return int(value)


def _number(value: str) -> float:
    try:
        return float(value)
    except ValueError:
        return math.nan


def faces_of(value: str) -> Literal["all"] | list[int]:
    """ "all", or face numbers with commas between them."""
    if value == "all":
        return "all"
    try:
        return [int(part) for part in value.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f'"all" or face numbers like 0 or 0,1, not {value!r}') from None


def two_faces_of(value: str) -> tuple[int, int]:
    """Two different face numbers with a comma between them."""
    parts = value.split(",")
    if len(parts) != 2 or not all(part.isdecimal() for part in parts) or int(parts[0]) == int(parts[1]):
        raise argparse.ArgumentTypeError(f"two different face numbers like 0,1, not {value!r}")
    return int(parts[0]), int(parts[1])
