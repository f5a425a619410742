"""How deep a face's features are: brows, lash lines and pupils beside its skin.

A hazy or softly lit clip has brows and eyes that are hardly darker than its skin. The transport of the open skin says
nothing of them, so a contrasty reference would give it skin alone, flat and veiled. Both faces have curves there: how
dark those are beside the skin is measured on both, and the tone curve goes that much deeper below the skin.
"""

from __future__ import annotations

import numpy as np

from pvg.asset import KeyFrame
from pvg.curves import table_labels
from pvg.looks.opponent import luma_of, median_luma

_FEATURES = ("brows", "eyes")
_DARKEST = 0.1  # quantile of luma along the curves of a feature: its hairs or lashes, not the skin between them
_FEWEST = 4  # visible samples of a feature
_CLEAR = 0.3  # of the skin's luma: what is as dark as that is clear, and darker would be ink [by eye]
_DEEPEST = 0.65  # at most; deeper, brows get hard and patchy [by blind choice]


def depth_of_features(key: KeyFrame, reference: KeyFrame) -> float:
    """What the luma of a clip's features is multiplied by beside its skin, to be as deep as a reference's.

    In [0.65, 1]; 1 where the reference's are no deeper, or are not seen. Both faces have open skin.
    """
    own, wanted = _darkest(key), _darkest(reference)
    if own is None or wanted is None:
        return 1.0
    return float(np.clip(max(wanted, _CLEAR) / max(own, _CLEAR), _DEEPEST, 1.0))


def _darkest(key: KeyFrame) -> float | None:
    """Luma of the darkest of `_FEATURES` over that of the skin: fair brows are no haze. None where all are hidden."""
    luma, skin = luma_of(key.colors), median_luma(key.skin)
    found = []
    for name in _FEATURES:
        on = table_labels().on_group(name) & key.visible
        if on.sum() >= _FEWEST:
            found.append(float(np.quantile(luma[on], _DARKEST)) / skin)
    return min(found, default=None)
