"""Diffusion curves: γ as labelled samples, the mask boundary, and the colours they carry from frame to frame (eq. 5)."""
