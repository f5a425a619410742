"""Made-up curves for the membrane's tests, and the direct solution of the same equations."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from pvg.membrane import Lattice, Membrane, MembraneOperator, build_membrane, cut_edges
from pvg.membrane.lattice import TARGET_HEIGHT

Layout = list[tuple[int, int, bool]]
FACE_WIDTH, FACE_HEIGHT = 800, 1096


def oval(x: float, y: float, a: float, b: float, count: int, turn: float = 1.0, start: float = 0.0) -> np.ndarray:
    """Samples of an ellipse, in fractions of the face's box; turn < 1 leaves it open."""
    angle = start + np.arange(count) / (count if turn == 1.0 else count - 1) * turn * 2 * np.pi
    return np.stack((x + a * np.cos(angle), y + b * np.sin(angle)), axis=1)


def synthetic_face() -> tuple[np.ndarray, Layout, np.ndarray]:
    """Curves of a face and corrections: a smooth skin field, other levels on lips, brows and eyes, up to ±70."""
    bridge = np.stack((np.full(13, 0.5), np.linspace(0.4, 0.58, 13)), axis=1)
    curves: list[tuple[np.ndarray, bool, float]] = [
        (oval(0.5, 0.52, 0.44, 0.44, 192), True, 0.0),
        (oval(0.5, 0.54, 0.36, 0.36, 65, 0.5), False, 0.0),
        (oval(0.5, 0.50, 0.28, 0.30, 108), True, 0.0),
        (oval(0.28, 0.60, 0.07, 0.06, 32), True, 0.0),
        (oval(0.72, 0.60, 0.07, 0.06, 32), True, 0.0),
        (bridge, False, 0.0),
        (oval(0.5, 0.58, 0.08, 0.04, 19, 0.5), False, 0.0),
        (oval(0.33, 0.42, 0.07, 0.02, 16), True, -35.0),
        (oval(0.67, 0.42, 0.07, 0.02, 16), True, -35.0),
        (oval(0.32, 0.35, 0.10, 0.018, 18), True, -25.0),
        (oval(0.68, 0.35, 0.10, 0.018, 18), True, -25.0),
        (oval(0.5, 0.72, 0.13, 0.05, 36), True, 25.0),
        (oval(0.5, 0.72, 0.10, 0.02, 24), True, 15.0),
    ]
    layout, offsets, stop = [], [], 0
    for samples, closed, offset in curves:
        layout.append((stop, stop + len(samples), closed))
        offsets.append(np.full(len(samples), offset))
        stop += len(samples)
    place = np.concatenate([samples for samples, _, _ in curves])
    field = [25 * np.sin(5 * place[:, 0] + k) + 20 * np.cos(4 * place[:, 1] - k) + 5 * k for k in range(3)]
    values = np.stack(field, axis=1) + np.concatenate(offsets)[:, None]
    points = place * (FACE_WIDTH, FACE_HEIGHT)
    return points, layout, values * (70.0 / np.abs(values).max())


def face_operator(target_height: int = TARGET_HEIGHT) -> tuple[MembraneOperator, np.ndarray]:
    points, layout, values = synthetic_face()
    lattice = Lattice.over((0, 0, FACE_WIDTH, FACE_HEIGHT), target_height=target_height)
    return build_membrane(cut_edges(points, layout, lattice)), values


def direct_on_lattice(operator: MembraneOperator, values: np.ndarray) -> np.ndarray:
    """SuperLU on the same cut-edge equations of eq. (1), assembled here from the cuts: (C, rows, columns)."""
    cuts = operator.cuts
    rows, columns = cuts.lattice.height, cuts.lattice.width
    _, _, w, _, _ = cuts.levels[0]
    position = (np.arange(rows)[:, None] + 1) * (w + 2) + np.arange(columns) + 1
    theta = cuts.theta[:, position]
    count = rows * columns
    flat = np.arange(count).reshape(rows, columns)
    right = np.isinf(theta[0, :, :-1]).ravel()
    down = np.isinf(theta[2, :-1]).ravel()
    i = np.concatenate((flat[:, :-1].ravel()[right], flat[:-1].ravel()[down]))
    j = np.concatenate((flat[:, 1:].ravel()[right], flat[1:].ravel()[down]))
    edges = sparse.csc_array((np.ones(len(i)), (i, j)), (count, count))
    edges = edges + edges.T
    size = cuts.theta.shape[1]
    ties, load = np.zeros(size), np.zeros((size, values.shape[1]))
    np.add.at(ties, cuts.node, cuts.weight)
    np.add.at(load, cuts.node, cuts.weight[:, None] * cuts.values(values))
    ties, load = ties[position].ravel(), load[position].reshape(count, -1)
    matrix = sparse.csc_array(sparse.diags_array(edges.sum(axis=0) + ties) - edges)
    return splu(matrix).solve(load).T.reshape(-1, rows, columns)


def values_at(membrane: Membrane, points: np.ndarray) -> np.ndarray:
    """What the nodes say between them at source points (n, 2), beyond them what the border says: (n, C)."""
    lattice = membrane.lattice
    limits = np.array([lattice.width - 1, lattice.height - 1])
    places = np.clip((points - np.array([lattice.x, lattice.y])) / lattice.step, 0.0, limits)
    corner = np.minimum(places.astype(int), limits - 1)
    (fx, fy), (x, y) = (places - corner).T, corner.T
    upper, lower = ((1 - fx) * membrane.planes[:, row, x] + fx * membrane.planes[:, row, x + 1] for row in (y, y + 1))
    return ((1 - fy) * upper + fy * lower).T


def random_curves(rng: np.random.Generator, width: int, height: int) -> tuple[np.ndarray, Layout, np.ndarray]:
    """A few random polylines, one of which surely crosses the lattice."""
    layout, stop = [], 0
    points = [np.array([[0.3 * width, -1.0], [0.6 * width, height + 1.0]])]
    counts = rng.integers(1, 9, rng.integers(0, 4))
    points += [rng.uniform(-0.2, 1.2, (count, 2)) * (width, height) for count in counts]
    for run in points:
        layout.append((stop, stop + len(run), bool(rng.integers(2))))
        stop += len(run)
    snapped = np.concatenate(points)
    snapped = np.where(rng.random(snapped.shape) < 0.2, np.rint(snapped), snapped)  # meet nodes and rows exactly
    return snapped, layout, rng.uniform(-70.0, 70.0, (stop, 2))
