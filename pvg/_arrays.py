"""Names for the arrays that everything here is made of; steps from 0 to 1, straight and smooth; turns of angles."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Ints = NDArray[np.int64]
Bytes = NDArray[np.uint8]
Bools = NDArray[np.bool_]

Reals = TypeVar("Reals", Floats, Doubles)
Values = TypeVar("Values", Floats, Doubles, float)


def ramp(values: Values, low: float, high: float) -> Values:
    """0 at `low`, 1 at `high`, a line between and level beyond them; `low` may be the greater."""
    clipped: Values = np.clip((values - low) / (high - low), 0.0, 1.0)
    return clipped


def smoothstep(values: Reals, low: float, high: float) -> Reals:
    """0 up to `low`, 1 from `high` on, smooth between (the cubic t² (3 − 2 t))."""
    t = ramp(values, low, high)
    stepped: Reals = t * t * (3.0 - 2.0 * t)
    return stepped


def short_turn(degrees: float) -> float:
    """An angle between two directions the short way round, in [-180, 180) degrees."""
    return (degrees + 180.0) % 360.0 - 180.0
