"""Compile the numba kernels into their cache, so that the first clip does not wait for it: `python -m pvg.warmup`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pvg.curves.labels import boundary_radius
from pvg.harmonic.fit import fit_boundary_colors
from pvg.membrane.lattice import Lattice, Membrane, build_membrane, rasterize_curves
from pvg.rendering.planes import Change, apply_change
from pvg.rendering.visibility import Visibility
from pvg.skin import SkinTracker, fit_skin_model
from pvg.skin.hair import Hair, veil
from pvg.skin.prior import locate
from pvg.video import Frame, PixelFormat, picture_of


def warm_up() -> None:
    """Run the skin tracker, the least-squares fit and the membrane solver once on a small disc."""
    turn = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    circle = np.stack([32 + 20 * np.cos(turn), 32 + 20 * np.sin(turn)], axis=1).astype(np.float32)
    y, x = np.mgrid[:64, :64]
    image = np.stack([x, y, x + y], axis=-1).astype(np.uint8)
    domain = np.hypot(x - 32, y - 32) < 22
    fit = fit_boundary_colors(image, domain, circle, h_min=2.0, rng=np.random.default_rng(0))
    raster = rasterize_curves(circle, ((0, len(circle), True),), Lattice.over((0, 0, 64, 64)))
    membrane = build_membrane(raster).solve(np.concatenate([fit.colors, fit.colors[:, :2]], axis=1))
    membrane.crop(8, 8, 32, 32)
    seen = Visibility(np.zeros(48, np.float32), np.arange(2), np.full((2, 48), 1 / 48, np.float32))
    seen.settle(fit.colors)
    for depth in (8, 10):
        frame = _frame(image, depth)
        _follow(frame)
        _apply(frame, membrane)


def _frame(rgb: NDArray[np.uint8], depth: int) -> Frame:
    """A frame of so many bits."""
    pixel_format = PixelFormat("yuv420p", depth, (1, 1), (0.299, 0.114), False)
    first, second, third = pixel_format.from_rgb(rgb)
    for plane in (first, second, third):
        plane.flags.writeable = False  # as the decoder's are: kernels are compiled for that
    # rows of the decoder's planes are longer than the picture's
    return Frame(0, 0, 0.0, pixel_format, (first[:, :60], second[:, :30], third[:, :30]))


def _follow(frame: Frame) -> None:
    """Follow the skin of a made-up face, in the whole picture and in a part of it."""
    turn = np.linspace(0, 2 * np.pi, 106, endpoint=False)
    points = np.stack([32 + 14 * np.sin(turn), 34 - 16 * np.cos(turn)], axis=1).astype(np.float32)
    points[33:43, 1], points[52:58], points[58:64], points[84:96] = 28, (26, 31), (38, 31), (32, 42)
    skin_points = points[np.arange(88) * 106 // 88]
    whole = picture_of(frame)
    for picture in (whole, whole.part((0, 0, 60, 60))):
        picture.thumbnail((16, 9))
        picture.warp(np.eye(2, 3), (16, 16))
        tracker = SkinTracker(fit_skin_model(picture, points, skin_points))
        matte = tracker.step(picture, points, skin_points)
    boundary_radius(matte.alpha.astype(np.float32), matte.to_raster(points))
    where = locate((64, 64), points, skin_points)
    for fair in (True, False):
        hair = Hair(fair, np.zeros(3, np.float32), np.eye(3, dtype=np.float32))
        veil(np.zeros((64, 64, 3), np.uint8), where.face, where, hair)


def _apply(frame: Frame, membrane: Membrane) -> None:
    """Apply a field and a number as contrast to a frame."""
    alpha = np.ones((32, 32), np.float32)
    for change in (Change(0, contrast_channel=3), Change(0, 1.1, low_channel=0)):
        apply_change(frame, (8, 8), alpha, membrane, change)


if __name__ == "__main__":
    warm_up()
    print("kernels are compiled")
