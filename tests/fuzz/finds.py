"""What fuzzing found, cut down to the bytes that matter; a case for each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pvg.asset.arrays import from_bytes

_NPY = b"\x93NUMPY\x01\x00"


@dataclass(frozen=True)
class Find:
    """what: went wrong, with `do` and these bytes; expected: the answer since."""

    what: str
    do: Callable[[bytes], object]
    data: bytes
    expected: type[Exception]


FINDS = (
    Find(
        "TokenError for an array whose header ends early",
        from_bytes,
        b'{"dtype": "|u1", "shape": [1]}\n' + _NPY + b"\x10\x00{'descr': (\n    ",
        ValueError,
    ),
)
