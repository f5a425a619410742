"""Diffusion curves: γ as labelled samples, the mask boundary, and the colours they carry through a clip (eq. 5)."""

from __future__ import annotations

from pvg.curves.labels import (
    BOUNDARY,
    BOUNDARY_SAMPLES,
    CURVES,
    GROUPS,
    CurveLabels,
    labels_by_length,
    place,
    table_labels,
)
from pvg.curves.mask_boundary import boundary_points, boundary_radius
from pvg.curves.propagation import CHAIN_RESET_FRAMES, Chain, ColorTable, Matching, match

__all__ = [
    "BOUNDARY",
    "BOUNDARY_SAMPLES",
    "CHAIN_RESET_FRAMES",
    "CURVES",
    "GROUPS",
    "Chain",
    "ColorTable",
    "CurveLabels",
    "Matching",
    "boundary_points",
    "boundary_radius",
    "labels_by_length",
    "match",
    "place",
    "table_labels",
]
