"""Carry the key frame's shape to another frame: a similarity and Gaussian radial basis functions at the landmarks."""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Doubles, Floats
from pvg.raster import scaled
from pvg.skin.parameters import SKIN_PRIOR

_WARP = SKIN_PRIOR.warp


def similarity(source: Floats, target: Floats) -> tuple[complex, complex]:
    """Least-squares a, b with target = a·source + b for points (n, 2) read as complex numbers."""
    s, t = source[:, 0] + 1j * source[:, 1], target[:, 0] + 1j * target[:, 1]
    s0, t0 = s - s.mean(), t - t.mean()
    a = complex(np.vdot(s0, t0) / max(float(np.vdot(s0, s0).real), 1e-9))
    return a, complex(t.mean() - a * s.mean())


def rbf_warp(shape: tuple[int, int], source: Floats, target: Floats) -> tuple[Floats, Floats]:
    """Maps x, y, (h, w) each, that take raster cells to where `source` (n, 2) goes to `target` (n, 2).

    The deviation from the best similarity is a regularised sum of Gaussians, so far from the points the map is
    nearly the similarity.
    """
    a, b = similarity(source, target)
    scale = float(np.sqrt(source.var(axis=0).sum())) + 1e-6
    centers: Doubles = np.asarray(source / scale, np.float64)
    moved = a * (source[:, 0] + 1j * source[:, 1]) + b
    offset = np.stack([target[:, 0] - moved.real, target[:, 1] - moved.imag], axis=1).astype(np.float64)
    weights = np.linalg.solve(_gaussians(centers, centers) + _WARP.stiffness * np.eye(len(centers)), offset)

    h, w = shape
    grid = _WARP.grid
    rows, columns = (scaled(np.arange(-1, -(-count // grid) + 1, dtype=np.float64), grid) for count in (h, w))
    gx, gy = np.meshgrid(columns, rows)
    at: Doubles = np.stack([gx.ravel(), gy.ravel()], axis=1)
    z = a * (at[:, 0] + 1j * at[:, 1]) + b
    coarse = np.stack([z.real, z.imag], axis=1) + _gaussians(at / scale, centers) @ weights
    coarse = coarse.reshape(*gx.shape, 2).astype(np.float32)
    fine = cv2.resize(coarse, (gx.shape[1] * grid, gx.shape[0] * grid), interpolation=cv2.INTER_LINEAR)
    fine = fine[grid : grid + h, grid : grid + w]
    return np.ascontiguousarray(fine[..., 0]), np.ascontiguousarray(fine[..., 1])


def _gaussians(at: Doubles, centers: Doubles) -> Doubles:
    """Basis functions (m, n): smooth, and nothing two face radii away."""
    squared = (at[:, :1] - centers[:, 0]) ** 2 + (at[:, 1:] - centers[:, 1]) ** 2
    values: Doubles = np.exp(-squared / (2 * _WARP.width**2))
    return values
