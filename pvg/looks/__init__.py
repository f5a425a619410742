"""Algorithm 1, transfer: new boundary colours for a clip, from a reference (eq. 7, 8)."""

from __future__ import annotations

from pvg.looks.look import CONTRAST_RANGE, PROTECTABLE, Contrast, Look, transfer

__all__ = ["CONTRAST_RANGE", "PROTECTABLE", "Contrast", "Look", "transfer"]
