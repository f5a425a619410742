"""What is told by how pictures follow each other goes by time: of a clip of many frames a second some are looked at."""

from __future__ import annotations

_USUAL_RATE = 25.0


def frames_a_step(frame_rate: float) -> int:
    """Frames from one that is looked at to the next, at least 1: so that some 25 a second are. Below 37.5 it is all."""
    return max(1, round(frame_rate / _USUAL_RATE))
