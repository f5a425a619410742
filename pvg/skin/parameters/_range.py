"""Where something rises from 0 to 1."""

from __future__ import annotations

Range = tuple[float, float]
