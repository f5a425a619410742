"""Harmonic B-splines on a quadtree (eq. 2), and the boundary colours g fitted in their space (eq. 3)."""

from pvg.harmonic.fit import BoundaryFit, fit_boundary_colors

__all__ = ["BoundaryFit", "fit_boundary_colors"]
