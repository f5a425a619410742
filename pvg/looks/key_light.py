"""Which of a reference's open skin shows its complexion: that in its key light.

Half a face may be lit by the sun and half by the sky. People name the complexion of the lit half; the median of both
is a mauve that no skin has. Shade that the key light reaches is richer than what is lit, since light is reflected by
skin more than once; shade that is bluer is lit by something else, and where there is much of it, it is left out.
"""

from __future__ import annotations

import numpy as np

from pvg._arrays import Floats
from pvg.looks.tone import to_opponent

_LIT = 0.6  # quantile of luma from which on skin is lit by the key light
_BLUER = 0.02  # of (B − Y) / Y, beyond the lit skin's median [measured: 30 faces, others have at most 16 % of this]
_MUCH = 0.2  # of the skin [measured: as above]


def in_key_light(skin: Floats) -> Floats:
    """The colours of open skin (n, 3), 0-255 RGB, without those of shade in a bluer light if they are many; (m, 3)."""
    if len(skin) == 0:
        return skin
    luma, blue, _ = to_opponent(skin).T
    luma = np.maximum(luma, 1.0)
    lit = luma >= np.quantile(luma, _LIT)
    bluer = ~lit & (blue / luma > np.median((blue / luma)[lit]) + _BLUER)
    return np.ascontiguousarray(skin[~bluer]) if bluer.mean() >= _MUCH else skin
