"""The even rate behind rounded time stamps: Matroska counts milliseconds, and 1001/24000 s are no number of these.

MP4 and MOV count in any step. Taken over as they are, such stamps would make an even rate a variable one there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise

_FASTEST = 125
"""Frames a second up to which a stamp that is off by two milliseconds is nearest to its own frame."""


def even_rate_of(stamps: Sequence[int], time_base: Fraction, rate: Fraction) -> Fraction | None:
    """The rate, where ascending time stamps are those of it but for rounding; None where they are exact, or are not.

    Frames may be left out: stamps are then some of those of the rate.
    """
    if time_base != Fraction(1, 1000) or not 0 < rate <= _FASTEST or not stamps:
        return None
    step = time_base * rate  # frames a tick, in whole numbers from here on: there may be many
    whole = step.denominator
    places = [(stamp - stamps[0]) * step.numerator for stamp in stamps]
    frames = [(2 * place + whole) // (2 * whole) for place in places]
    off = [abs(place - frame * whole) for place, frame in zip(places, frames, strict=True)]
    if not any(off) or max(off) > step.numerator or any(later <= frame for frame, later in pairwise(frames)):
        return None
    return rate


class EvenTimes:
    """Time stamps of an even rate, each for that which it was rounded to.

    first: the rounded stamp of the first frame, in `given` seconds a tick. time_base: seconds a tick of what is given
    back; both the rate's frames and the rounded stamps are whole numbers of it.
    """

    def __init__(self, rate: Fraction, given: Fraction, first: int = 0) -> None:
        self.time_base = Fraction(1, math.lcm(rate.numerator, given.denominator))
        self._rate, self._given, self._first = rate, given, first

    def ticks(self, stamp: int) -> int:
        """The stamp of the frame nearest to a rounded one; one that is off by more than rounding stays when it is."""
        frame = round((stamp - self._first) * self._given * self._rate)
        time, given = self._first * self._given + frame / self._rate, stamp * self._given
        return round((time if abs(time - given) <= 2 * self._given else given) / self.time_base)
