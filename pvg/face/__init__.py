"""What a face is: the named points of its landmarks, and its own axes in a picture."""

from __future__ import annotations

from pvg.face.axes import FaceAxes
from pvg.face.landmarks import Landmarks

__all__ = ["FaceAxes", "Landmarks"]
