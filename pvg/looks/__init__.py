"""Algorithm 1, transfer: new boundary colours for a clip, from a reference (eq. 7, 8)."""
