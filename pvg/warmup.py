"""Compile the numba kernels into their cache, so that the first clip does not wait for it: `python -m pvg.warmup`."""

from __future__ import annotations

import numpy as np

from pvg.applying import Change, apply_change
from pvg.boundary import fit_boundary_colors
from pvg.poisson import Lattice, Membrane, build_membrane, rasterize_curves
from pvg.video import Frame, PixelFormat


def warm_up() -> None:
    """Run the least-squares fit and the membrane solver once on a small disc."""
    turn = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    circle = np.stack([32 + 20 * np.cos(turn), 32 + 20 * np.sin(turn)], axis=1).astype(np.float32)
    y, x = np.mgrid[:64, :64]
    image = np.stack([x, y, x + y], axis=-1).astype(np.uint8)
    domain = np.hypot(x - 32, y - 32) < 22
    fit = fit_boundary_colors(image, domain, circle, h_min=2.0, rng=np.random.default_rng(0))
    raster = rasterize_curves(circle, ((0, len(circle), True),), Lattice.over((0, 0, 64, 64)))
    membrane = build_membrane(raster).solve(np.concatenate([fit.colors, fit.colors[:, :2]], axis=1))
    membrane.crop(8, 8, 32, 32)
    for depth in (8, 10):
        _apply(membrane, depth)


def _apply(membrane: Membrane, depth: int) -> None:
    """Apply a field and a number as contrast to a frame of so many bits."""
    pixel_format = PixelFormat("yuv420p", depth, (1, 1), (0.299, 0.114), False)
    planes = pixel_format.from_rgb(np.full((64, 64, 3), 100))
    for plane in planes:
        plane.flags.writeable = False  # as the decoder's are: kernels are compiled for that
    frame = Frame(0, 0, 0.0, pixel_format, planes)
    alpha = np.ones((32, 32), np.float32)
    for change in (Change(0, contrast_channel=3), Change(0, 1.1, low_channel=0)):
        apply_change(frame, (8, 8), alpha, membrane, change)


if __name__ == "__main__":
    warm_up()
    print("kernels are compiled")
