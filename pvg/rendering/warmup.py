"""Compile the kernels of rendering on made-up corrections."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pvg._arrays import Bytes, Floats
from pvg.looks import LookMap, SkinMap
from pvg.membrane import Membrane
from pvg.rendering.blocks import divide_sums
from pvg.rendering.body import apply_body
from pvg.rendering.bounded import beyond_bound_of_means
from pvg.rendering.correction import Correction
from pvg.rendering.edges import refine
from pvg.rendering.foreground import foreground
from pvg.rendering.guards import Guard
from pvg.rendering.makeup import add_part
from pvg.rendering.map_tables import MapTables
from pvg.rendering.placed_body import place_body
from pvg.rendering.planes import apply_correction, fade_in_dark
from pvg.rendering.visibility import Visibility
from pvg.skin import Matte
from pvg.video import Frame


def warm_up(frames: Sequence[Frame], membrane: Membrane, colors: Floats) -> None:
    """Apply a number and a map as contrast to each kind of frame, add a part, and settle hidden samples.

    frames: of at least 40×40 pixels;  membrane: of three channels over them;  colors: (S, 3) at its curves.
    """
    count = len(colors)
    seen = Visibility(np.zeros(count, np.float32), np.arange(2), np.full((2, count), 1 / count, np.float32))
    seen.settle(colors)
    add_part(membrane.planes.copy(), np.zeros(3, np.float32), membrane.planes[0])
    means = np.zeros((4, 4, 3), np.float32)
    divide_sums(means, means[..., 0].copy(), means.copy(), np.float32(0.0))
    alpha, planes, lattice = np.ones((32, 32), np.float32), membrane.planes, membrane.lattice
    number = Correction(lattice, planes, 1.1, planes)
    darker = SkinMap.between(colors, 0.6 * colors.astype(np.float64))  # a map that moves nothing has no bound
    look_map = LookMap(darker, 1.0, np.ones((1, 5), np.float32))
    matte = Matte.over(np.array([8, 8, 40, 40], np.float32), np.eye(8, dtype=np.uint8) * np.uint8(255))
    guard = Guard(8, 8, np.ones((8, 8), np.float32), np.zeros(2, np.float32))
    for frame in frames:
        tables, beside = (MapTables.of(look_map, frame.format, region=region) for region in ("face", "beside"))
        for correction in (number, Correction(lattice, planes, tables, around=planes[0])):
            skin = foreground(frame, (8, 8), alpha, 4.0) if correction.mapped else None
            fade = fade_in_dark(frame, (8, 8), alpha, [correction], skin)
            apply_correction(frame, (8, 8), alpha, correction, guards=[(guard, 0.8)], fade=fade, skin=skin)
        refine(alpha, (8, 8), matte, frame)
        body = Matte.over(np.array([0, 0, frame.width, frame.height], np.float32), _spot())
        bodies = place_body(frame, body, (), ())
        place_body(frame, body, (), bodies)  # which leaves nothing
        for placed in bodies:
            shown = foreground(frame, (placed.x, placed.y), placed.alpha, placed.step)
            apply_body(frame, placed, shown, beside)
        beyond_bound_of_means(beside, colors)
        tables.foreign_at_curves(colors)  # by the kernel that looks at pixels too


def _spot() -> Bytes:
    """A small matte with some skin in its middle."""
    alpha = np.zeros((16, 16), np.uint8)
    alpha[4:12, 4:12] = 255
    return alpha
