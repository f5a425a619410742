"""Whether a face has a beard that is darker than its skin."""

from __future__ import annotations

from functools import cache

import numpy as np

from pvg._arrays import Bools, ramp
from pvg.asset import KeyFrame
from pvg.curves import table_labels
from pvg.looks.opponent import luma_of, median_luma

_PLACES = ("upper_lip", "chin")  # curves that a beard covers; one of them is enough
# of the skin's luma, from where a beard may be to where it is [measured: the darker of both curves 0.69 to 1.1 on 24
# faces without a beard, 0.26 to 0.55 on 5 with one]
_DARK = (0.65, 0.55)


def beard_of(key: KeyFrame) -> float:
    """How surely a key frame shows a dark beard, in [0, 1]; 0 where no open skin or none of its places is seen."""
    if not len(key.skin):
        return 0.0
    luma, skin = luma_of(key.colors), median_luma(key.skin)
    seen = (place & key.visible for place in _places())
    darkest = min((float(np.median(luma[on])) for on in seen if on.any()), default=skin)
    return float(ramp(np.float64(darkest / skin), *_DARK))


@cache
def _places() -> tuple[Bools, ...]:
    """Of each of `_PLACES` its samples of the table, (S,)."""
    return tuple(table_labels().on_curves(place) for place in _PLACES)
