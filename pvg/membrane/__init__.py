"""The membrane: the harmonic extension of values on the curves (eq. 1)."""

from __future__ import annotations

from pvg.membrane.lattice import TOLERANCE, CurveRaster, Lattice, Membrane, build_membrane, rasterize_curves

__all__ = ["TOLERANCE", "CurveRaster", "Lattice", "Membrane", "build_membrane", "rasterize_curves"]
