"""Compile the numba kernels into their cache, so that the first clip does not wait for it: `python -m pvg.warmup`."""

from __future__ import annotations

import numpy as np

from pvg.boundary import fit_boundary_colors
from pvg.poisson import Lattice, build_membrane, rasterize_curves


def warm_up() -> None:
    """Run the least-squares fit and the membrane solver once on a small disc."""
    turn = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    circle = np.stack([32 + 20 * np.cos(turn), 32 + 20 * np.sin(turn)], axis=1).astype(np.float32)
    y, x = np.mgrid[:64, :64]
    image = np.stack([x, y, x + y], axis=-1).astype(np.uint8)
    domain = np.hypot(x - 32, y - 32) < 22
    fit = fit_boundary_colors(image, domain, circle, h_min=2.0, rng=np.random.default_rng(0))
    raster = rasterize_curves(circle, ((0, len(circle), True),), Lattice.over((0, 0, 64, 64)))
    build_membrane(raster).solve(fit.colors).crop(8, 8, 32, 32)


if __name__ == "__main__":
    warm_up()
    print("kernels are compiled")
