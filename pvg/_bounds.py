"""Where the parts of a long clip begin and end: arithmetic alone, for who draws them and for who hands them out."""

from __future__ import annotations

from fractions import Fraction
from typing import Final

PART_S: Final = 7.5
"""Seconds of a part. [measured: a minute is eight parts, which four workers do in two turns, as they do six of 10 s;
key pictures cost about 2 % of the bytes with 5 s and with 10]"""
_LEAST_FRAMES: Final = 8  # more than any encoder reorders
_MOST_PARTS: Final = 480  # those of an hour: a rate that a header only claims makes no more


def part_bounds(frame_count: int, frame_rate: Fraction | float | None, *, part_s: float = PART_S) -> tuple[int, ...]:
    """Where the parts of a clip begin and end: (0, …, frame_count), as equal as whole frames are.

    Each has at least ``part_s`` seconds, and less than twice that: were the last one longer than the others, everybody
    would wait for it. frame_rate: frames a second on average, as `probe` has it or rounded to thousandths. A clip
    shorter than two parts is one. The same for everybody who knows these two numbers.
    """
    if not frame_rate:
        return (0, frame_count)
    length = max(_LEAST_FRAMES, round(part_s * round(float(frame_rate), 3)), -(-frame_count // _MOST_PARTS))
    count = max(1, frame_count // length)
    return tuple(k * frame_count // count for k in range(count + 1))
