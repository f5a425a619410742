"""The membrane: the harmonic extension of values on the curves (eq. 1)."""
