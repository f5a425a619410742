"""Algorithm 1, rendering: u' = λI + H(g' − λg) drawn into the planes of a clip (eq. 1)."""

from __future__ import annotations

from pvg._bounds import PART_S, part_bounds
from pvg.rendering.clip import placed_faces, render, render_frame, source_frame, swap
from pvg.rendering.clip_parts import join_parts, render_part
from pvg.rendering.layers import LAYERS, layer
from pvg.rendering.matte_files import MATTES
from pvg.rendering.pictures import PictureFormat, around, cropped, encoded, fitted
from pvg.rendering.placed_face import PlacedFace
from pvg.rendering.renderer import Renderer
from pvg.rendering.stills import Stills
from pvg.rendering.suite_files import SUITE_FILES, export
from pvg.rendering.warmup import warm_up
from pvg.video import can_join

__all__ = [
    "LAYERS",
    "MATTES",
    "PART_S",
    "SUITE_FILES",
    "PictureFormat",
    "PlacedFace",
    "Renderer",
    "Stills",
    "around",
    "can_join",
    "cropped",
    "encoded",
    "export",
    "fitted",
    "join_parts",
    "layer",
    "part_bounds",
    "placed_faces",
    "render",
    "render_frame",
    "render_part",
    "source_frame",
    "swap",
    "warm_up",
]
