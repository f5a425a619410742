"""Algorithm 1, rendering: u' = λI + H(g' − λg) drawn into the planes of a clip (eq. 1)."""

from __future__ import annotations

from pvg.rendering.clip import placed_faces, render, render_frame, source_frame, swap
from pvg.rendering.layers import LAYERS, layer
from pvg.rendering.placed_face import PlacedFace
from pvg.rendering.renderer import Renderer
from pvg.rendering.warmup import warm_up

__all__ = [
    "LAYERS",
    "PlacedFace",
    "Renderer",
    "layer",
    "placed_faces",
    "render",
    "render_frame",
    "source_frame",
    "swap",
    "warm_up",
]
