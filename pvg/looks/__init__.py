"""Algorithm 1, transfer: new boundary colours for a clip, from a reference (eq. 7, 8)."""

from __future__ import annotations

from pvg.looks.look import CONTRAST_RANGE, EXTENTS, PROTECTABLE, BodyMap, Contrast, Look
from pvg.looks.tone import SkinMap
from pvg.looks.transfer import BETA, ITERATIONS, transfer
from pvg.looks.transport import sliced_transport, sliced_wasserstein

__all__ = [
    "BETA",
    "CONTRAST_RANGE",
    "EXTENTS",
    "ITERATIONS",
    "PROTECTABLE",
    "BodyMap",
    "Contrast",
    "Look",
    "SkinMap",
    "sliced_transport",
    "sliced_wasserstein",
    "transfer",
]
