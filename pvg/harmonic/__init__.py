"""Harmonic B-splines on a quadtree, and the boundary colours fitted in their space (eq. 2, 3)."""

from __future__ import annotations

from pvg.harmonic.fit import BoundaryFit, fit_boundary_colors

__all__ = ["BoundaryFit", "fit_boundary_colors"]
