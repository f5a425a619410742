"""Algorithm 1, transfer: new boundary colours for a clip, from a reference (eq. 7, 8)."""

from __future__ import annotations

from pvg.looks.cube import CUBE_SIZE, check_size, look_cube, remainder_by_luma, write_cube
from pvg.looks.exchange import LookOptions, contrast_of_both, exchange
from pvg.looks.look import PROTECTABLE, Contrast, Look, LookMap, Region, check_looks
from pvg.looks.opponent import to_opponent, to_rgb
from pvg.looks.parts import MAKEUP
from pvg.looks.skin_map import SkinMap
from pvg.looks.transfer import LIGHT, reference_face_of, transfer
from pvg.looks.transport import sliced_transport, sliced_wasserstein
from pvg.looks.usual_chroma import LEAST_TINGE, likeness

__all__ = [
    "CUBE_SIZE",
    "LEAST_TINGE",
    "LIGHT",
    "MAKEUP",
    "PROTECTABLE",
    "Contrast",
    "Look",
    "LookMap",
    "LookOptions",
    "Region",
    "SkinMap",
    "check_looks",
    "check_size",
    "contrast_of_both",
    "exchange",
    "likeness",
    "look_cube",
    "reference_face_of",
    "remainder_by_luma",
    "sliced_transport",
    "sliced_wasserstein",
    "to_opponent",
    "to_rgb",
    "transfer",
    "write_cube",
]
