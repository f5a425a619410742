"""Harmonic B-splines on a quadtree, and the boundary colours fitted in their space (eq. 2, 3)."""
