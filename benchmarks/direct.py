"""The membrane by a direct solver at full size, with the curves as pixels: what ours is compared with."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from pvg._arrays import Bools, Doubles


def held_pixels(
    points: Doubles, spans: tuple[tuple[int, int, bool], ...], values: Doubles, size: tuple[int, int]
) -> tuple[Doubles, Bools]:
    """The curves as 4-connected pixels: mean values (h, w, C) and which pixels are held (h, w)."""
    w, h = size
    total, hits = np.zeros((h, w, values.shape[1])), np.zeros((h, w))
    for start, stop, closed in spans:
        for i, j in pairwise([*range(start, stop), *([start] if closed else [])]):
            share = np.linspace(0.0, 1.0, int(np.abs(points[j] - points[i]).sum() * 8) + 2)[:, None]
            pixel = np.rint(points[i] + share * (points[j] - points[i])).astype(int)
            value = values[i] + share * (values[j] - values[i])
            diagonal = np.flatnonzero((np.diff(pixel, axis=0) != 0).all(axis=1))
            corner = np.stack([pixel[diagonal, 0], pixel[diagonal + 1, 1]], axis=1)
            where, what = np.concatenate([pixel, corner]), np.concatenate([value, value[diagonal]])
            within = ((where >= 0) & (where < (w, h))).all(axis=1)
            np.add.at(total, (where[within, 1], where[within, 0]), what[within])
            np.add.at(hits, (where[within, 1], where[within, 0]), 1.0)
    return total / np.maximum(hits, 1.0)[..., None], hits > 0


def direct_membrane(held: Doubles, known: Bools, domain: Bools) -> Doubles:
    """The 5-point equations at every pixel of `domain` by SuperLU, pixels `known` held: (h, w, C) like `held`.

    Only neighbours within the domain enter, so its edge has zero flux where it is not held.
    """
    unknown = domain & ~known
    number = np.where(unknown, np.cumsum(unknown).reshape(unknown.shape) - 1, -1)
    count = int(unknown.sum())
    degree, load = np.zeros(count), np.zeros((count, held.shape[2]))
    rows, columns = [], []
    flat = np.arange(domain.size).reshape(domain.shape)
    across, down = (flat[:, :-1].ravel(), flat[:, 1:].ravel()), (flat[:-1].ravel(), flat[1:].ravel())
    inside, fixed, numbers = domain.ravel(), known.ravel(), number.ravel()
    colors = held.reshape(-1, held.shape[2])
    for here, there in (across, across[::-1], down, down[::-1]):
        used = (numbers[here] >= 0) & inside[there]
        i, j = here[used], there[used]
        degree += np.bincount(numbers[i], minlength=count)
        border = fixed[j]
        for channel in range(load.shape[1]):
            load[:, channel] += np.bincount(numbers[i[border]], colors[j[border], channel], minlength=count)
        rows.append(numbers[i[~border]])
        columns.append(numbers[j[~border]])
    i, j = np.concatenate(rows), np.concatenate(columns)
    matrix = sparse.csc_array((-np.ones(len(i)), (i, j)), (count, count)) + sparse.diags_array(degree)
    factors = splu(sparse.csc_array(matrix), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    solved = np.where(known[..., None], held, 0.0)
    solved[unknown] = factors.solve(load)
    return solved
