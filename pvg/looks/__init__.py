"""Algorithm 1, transfer: new boundary colours for a clip, from a reference (eq. 7, 8)."""

from __future__ import annotations

from pvg.looks.look import CONTRAST_RANGE, PROTECTABLE, Contrast, Look
from pvg.looks.parts import MAKEUP, Makeup
from pvg.looks.tone import SkinMap, to_rgb
from pvg.looks.transfer import BETA, ITERATIONS, transfer
from pvg.looks.transport import sliced_transport, sliced_wasserstein

__all__ = [
    "BETA",
    "CONTRAST_RANGE",
    "ITERATIONS",
    "MAKEUP",
    "PROTECTABLE",
    "Contrast",
    "Look",
    "Makeup",
    "SkinMap",
    "sliced_transport",
    "sliced_wasserstein",
    "to_rgb",
    "transfer",
]
