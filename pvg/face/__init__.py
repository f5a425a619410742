"""What a face is: the named points of its landmarks, its own axes in a picture, and its parts apart from the skin."""

from __future__ import annotations

from pvg.face.axes import FaceAxes
from pvg.face.cover import soft_cover
from pvg.face.landmarks import Landmarks
from pvg.face.parts import PARTS, Outline, add_cover, feather, part_outlines, taken

__all__ = ["PARTS", "FaceAxes", "Landmarks", "Outline", "add_cover", "feather", "part_outlines", "soft_cover", "taken"]
