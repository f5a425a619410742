"""Which of a reference's open skin shows its complexion: that in its key light.

Half a face may be lit by the sun and half by the sky. People name the complexion of the lit half; the median of both
is a mauve that no skin has. Shade that the key light reaches is richer than what is lit, since light is reflected by
skin more than once; shade that is bluer is lit by something else, and where there is much of it, it is left out.

Under the peak of a cap most of a face may be nearly black while its nose and cheeks are in the sun: its complexion is
that of nose and cheeks. Made as bright as a clip, skin out of such a shade is a brown or a grey that nobody has.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from pvg._arrays import Bools, Floats, ramp
from pvg.asset import KeyFrame
from pvg.looks.opponent import luma_of, to_opponent

_LIT = 0.6  # quantile of luma from which on skin is lit by the key light
_BLUER = 0.02  # of (B − Y) / Y, beyond the lit skin's median [measured: 30 faces, others have at most 16 % of this]
_MUCH = 0.2  # of the skin [measured: as above]
_BRIGHT = 0.9  # quantile of luma
# of it over the median: from which on most of the skin is in deep shade, and surely so [measured: 39 faces in usual
# light have at most 1.6, one under a cap 3.9]
_DEEP = (1.7, 2.2)


def with_lit_skin(key: KeyFrame) -> KeyFrame:
    """A key frame whose open skin is that out of deep shade."""
    lit = _out_of_deep_shade(key.skin)
    return key if lit.all() else replace(key, skin=np.ascontiguousarray(key.skin[lit]), skin_at=key.skin_at[lit])


def _out_of_deep_shade(skin: Floats) -> Bools:
    """(n,) which colours of open skin (n, 3), 0-255 RGB, are not in deep shade, if most are; all where not.

    Shade is told from light by Otsu's threshold of luma (IEEE Trans. SMC 9, 1979).
    """
    if len(skin) == 0:
        return np.ones(0, np.bool_)
    luma = luma_of(skin)
    bright, middle = np.quantile(luma, (_BRIGHT, 0.5))
    surely = ramp(float(bright) / max(float(middle), 1.0), *_DEEP)
    if surely == 0.0:
        return np.ones(len(skin), np.bool_)
    shade, _ = cv2.threshold(np.clip(luma, 0, 255).astype(np.uint8), 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    return np.asarray(luma >= surely * shade)


def in_key_light(skin: Floats) -> Floats:
    """The colours of open skin (n, 3), 0-255 RGB, without those of shade in a bluer light if they are many; (m, 3)."""
    if len(skin) == 0:
        return skin
    luma, blue, _ = to_opponent(skin).T
    luma = np.maximum(luma, 1.0)
    lit = luma >= np.quantile(luma, _LIT)
    bluer = ~lit & (blue / luma > np.median((blue / luma)[lit]) + _BLUER)
    return np.ascontiguousarray(skin[~bluer]) if bluer.mean() >= _MUCH else skin
