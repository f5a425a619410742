"""Multigrid for the 5-point equations of eq. (1): conjugate gradients preconditioned by one V(2, 2)-cycle.

All arrays but those of the conjugate gradients hold every level (see `lattice`): u the unknowns, b the right-hand
side. The kernels assume finite numbers (fastmath), which lets sums and maxima use vector registers.
"""

from __future__ import annotations

import numpy as np

from pvg._arrays import Floats, Ints
from pvg._compiled import kernel
from pvg.membrane.equations import FivePoint

# Two Jacobi steps with the Chebyshev weights for the eigenvalues [0.5, 2] of the scaled matrix damp the high half of
# the spectrum to 0.22, like one red-black Gauss-Seidel sweep, and vectorise. [derived]
_OMEGA_1 = np.float32(1.0 / (1.25 + 0.75 * np.sqrt(0.5)))
_OMEGA_2 = np.float32(1.0 / (1.25 - 0.75 * np.sqrt(0.5)))

# What the estimate of the error takes a cycle to leave of it: the first change has no predecessor to compare with, and
# the first cycles look faster than the lasting rate. [measured: 0.06 to 0.36 a cycle on made-up faces]
_FIRST_RATE = np.float32(0.5)
_LEAST_RATE = np.float32(0.35)

# Nodes along the last level up to which sweeps solve it; their number grows with its square. [derived: the last level
# of a box is longer where one of its sides is four times the other or more]
_LONGEST_SWEPT = 16


@kernel(fastmath=True)
def _flat(array: Floats, level: Ints) -> Floats:
    """The numbers of a level in an array over all levels, its ring included."""
    o, h, w = level[0], level[1], level[2]
    return array[o : o + (h + 2) * (w + 2)]


@kernel(fastmath=True)
def _block(array: Floats, level: Ints) -> Floats:
    """The same as (h + 2, w + 2)."""
    return _flat(array, level).reshape((level[1] + 2, level[2] + 2))


@kernel(fastmath=True)
def _jacobi(
    u: Floats, b: Floats, east: Floats, south: Floats, inverse: Floats, width: int, omega: np.float32, out: Floats
) -> None:
    """out = u + ω (inverse (b + Σ edge·neighbour) − u), one damped Jacobi step on a level.

    All rows in one run, their rings included: no edge leads there and the inverse is zero, so zeros they stay. A slice
    costs as much as 50 nodes, so rows are not sliced.
    """
    first, last = width, len(u) - width
    row, up, below = u[first:last], u[: last - width], u[first + width :]
    left, right = u[first - 1 : last - 1], u[first + 1 : last + 1]
    ee, ew, ss, sn = east[first:last], east[first - 1 : last - 1], south[first:last], south[: last - width]
    v, rhs, to = inverse[first:last], b[first:last], out[first:last]
    for i in range(last - first):
        near = rhs[i] + ee[i] * right[i] + ew[i] * left[i] + ss[i] * below[i] + sn[i] * up[i]
        to[i] = row[i] + omega * (v[i] * near - row[i])


@kernel(fastmath=True)
def _smooth(
    u: Floats, b: Floats, scratch: Floats, A: FivePoint, levels: Ints, level: int, sweeps: int, from_zero: bool
) -> None:
    """Pairs of Jacobi steps on a level, by way of `scratch`, whose rings are zero; u is not read if `from_zero`."""
    here = levels[level]
    x, rhs, t = _flat(u, here), _flat(b, here), _flat(scratch, here)
    east, south, inverse = _flat(A.east, here), _flat(A.south, here), _flat(A.inverse_diagonal, here)
    width = here[2] + 2
    for sweep in range(sweeps):
        if from_zero and sweep == 0:
            for i in range(len(x)):
                t[i] = _OMEGA_1 * inverse[i] * rhs[i]
        else:
            _jacobi(x, rhs, east, south, inverse, width, _OMEGA_1, t)
        _jacobi(t, rhs, east, south, inverse, width, _OMEGA_2, x)


@kernel(fastmath=True)
def _add_product(u: Floats, A: FivePoint, here: Ints, sign: np.float32, out: Floats) -> None:
    """out += sign · A u, u and out on one level: the left-hand side of eq. (1)."""
    east, south, diagonal = _flat(A.east, here), _flat(A.south, here), _flat(A.diagonal, here)
    width = here[2] + 2
    first, last = width, len(u) - width
    row, up, below = u[first:last], u[: last - width], u[first + width :]
    left, right = u[first - 1 : last - 1], u[first + 1 : last + 1]
    ee, ew, ss, sn = east[first:last], east[first - 1 : last - 1], south[first:last], south[: last - width]
    d, to = diagonal[first:last], out[first:last]
    for i in range(last - first):
        near = ee[i] * right[i] + ew[i] * left[i] + ss[i] * below[i] + sn[i] * up[i]
        to[i] += sign * (d[i] * row[i] - near)


@kernel(fastmath=True)
def _residual(u: Floats, b: Floats, A: FivePoint, here: Ints, r: Floats) -> None:
    """r = b − A u on one level."""
    r[:] = b
    _add_product(u, A, here, np.float32(-1.0), r)


@kernel(fastmath=True)
def _restrict(u: Floats, b: Floats, scratch: Floats, A: FivePoint, share: Floats, levels: Ints, level: int) -> None:
    """The next level's b = sums over 2 × 2 blocks of the residual, each child with its share of the block's correction.

    This is the transpose of `_prolong` without its slopes.
    """
    here, coarser = levels[level], levels[level + 1]
    _residual(_flat(u, here), _flat(b, here), A, here, _flat(scratch, here))
    fine, coarse = _block(scratch, here), _block(b, coarser)
    right, left = _block(share[0], coarser), _block(share[1], coarser)
    down, up = _block(share[2], coarser), _block(share[3], coarser)
    half = here[2] // 2
    for y in range(1, here[1] // 2 + 1):
        to, sr, sl = coarse[y, 1 : half + 1], right[y, 1 : half + 1], left[y, 1 : half + 1]
        sd, su = down[y, 1 : half + 1], up[y, 1 : half + 1]
        upper, lower = fine[2 * y - 1, 1:], fine[2 * y, 1:]
        for x in range(half):
            to[x] = sl[x] * (su[x] * upper[2 * x] + sd[x] * lower[2 * x]) + sr[x] * (
                su[x] * upper[2 * x + 1] + sd[x] * lower[2 * x + 1]
            )
    _clear_ring(fine)


@kernel(fastmath=True)
def _clear_ring(block: Floats) -> None:
    block[0], block[-1] = np.float32(0.0), np.float32(0.0)
    block[:, 0], block[:, -1] = np.float32(0.0), np.float32(0.0)


@kernel(fastmath=True)
def _prolong(u: Floats, A: FivePoint, share: Floats, levels: Ints, level: int, keep: np.float32) -> None:
    """u = keep·u + the interpolation of the block centres, bilinear along whole edges, falling to zero at cuts."""
    here, coarser = levels[level], levels[level + 1]
    coarse, fine = _block(u, coarser), _block(u, here)
    east, south, inverse = _block(A.east, coarser), _block(A.south, coarser), _block(A.inverse_diagonal, here)
    right, left = _block(share[0], coarser), _block(share[1], coarser)
    down, up = _block(share[2], coarser), _block(share[3], coarser)
    half = here[2] // 2
    q, none = np.float32(0.25), np.float32(0.0)
    for y in range(1, here[1] + 1):
        yc = (y + 1) // 2
        if y % 2 == 1:
            other, edge, sy = coarse[yc - 1, 1 : half + 1], south[yc - 1, 1 : half + 1], up[yc, 1 : half + 1]
        else:
            other, edge, sy = coarse[yc + 1, 1 : half + 1], south[yc, 1 : half + 1], down[yc, 1 : half + 1]
        row, row_west, row_east = coarse[yc, 1 : half + 1], coarse[yc, 0:half], coarse[yc, 2 : half + 2]
        ee, ew = east[yc, 1 : half + 1], east[yc, 0:half]
        sr, sl, v, to = right[yc, 1 : half + 1], left[yc, 1 : half + 1], inverse[y, 1:], fine[y, 1:]
        for x in range(half):
            middle = sy[x] * row[x] + q * edge[x] * (other[x] - row[x])
            # the slope along the row is taken at the centre; the mixed term of the bilinear form is left out
            west = sl[x] * middle + q * ew[x] * (row_west[x] - row[x])
            easterly = sr[x] * middle + q * ee[x] * (row_east[x] - row[x])
            # nodes of an odd row or column's padding stay zero
            to[2 * x] = keep * to[2 * x] + (west if v[2 * x] > none else none)
            to[2 * x + 1] = keep * to[2 * x + 1] + (easterly if v[2 * x + 1] > none else none)


@kernel(fastmath=True)
def _solve_long(u: Floats, b: Floats, A: FivePoint, here: Ints) -> None:
    """u = A⁻¹ b on a level that is a few nodes across, whatever its length: a Cholesky factorisation of its band.

    Nodes follow each other across the level, so that neighbours are at most its breadth apart.
    """
    h, w = here[1], here[2]
    x, rhs, row = _flat(u, here), _flat(b, here), w + 2
    diagonal, east, south = _flat(A.diagonal, here), _flat(A.east, here), _flat(A.south, here)
    upright = h >= w
    breadth, length = (w, h) if upright else (h, w)
    count = breadth * length
    place = np.empty(count, np.int64)  # of each node in the level's arrays
    band = np.zeros((count, breadth + 1))  # band[n, k] of L is that of node n and the one k before it
    z = np.empty(count)
    for n in range(count):
        along, across = n // breadth + 1, n % breadth + 1
        place[n] = along * row + across if upright else across * row + along
        i = place[n]
        to_side, to_before = (east[i - 1], south[i - row]) if upright else (south[i - row], east[i - 1])
        band[n, 0] = diagonal[i] if diagonal[i] > 0.0 else 1.0  # padding: zero it stays
        if across > 1:
            band[n, 1] = -to_side
        if along > 1:
            band[n, breadth] = -to_before
        z[n] = rhs[i] if diagonal[i] > 0.0 else 0.0
    for n in range(count):
        for k in range(min(breadth, n), -1, -1):
            m = n - k
            for j in range(1, min(breadth - k, m) + 1):
                band[n, k] -= band[n, k + j] * band[m, j]
            band[n, k] = band[n, k] / band[m, 0] if k > 0 else np.sqrt(band[n, 0])
        for k in range(1, min(breadth, n) + 1):
            z[n] -= band[n, k] * z[n - k]
        z[n] /= band[n, 0]
    for n in range(count - 1, -1, -1):
        for k in range(1, min(breadth, count - 1 - n) + 1):
            z[n] -= band[n + k, k] * z[n + k]
        z[n] /= band[n, 0]
        x[place[n]] = z[n]


@kernel(fastmath=True)
def _v_cycle(
    u: Floats, b: Floats, scratch: Floats, A: FivePoint, share: Floats, levels: Ints, top: int, from_zero: bool
) -> None:
    """One V(2, 2)-cycle from level `top` down: two Jacobi steps before and after each correction."""
    last = len(levels) - 1
    for level in range(top, last):
        _smooth(u, b, scratch, A, levels, level, 1, from_zero or level > top)
        _restrict(u, b, scratch, A, share, levels, level)
    # the last level is at most a few nodes across, but may be long
    longest = max(levels[last, 1], levels[last, 2])
    if longest > _LONGEST_SWEPT:
        _solve_long(u, b, A, levels[last])
    else:
        _smooth(u, b, scratch, A, levels, last, 8 + longest**2 // 8, from_zero or last > top)
    for level in range(last - 1, top - 1, -1):
        _prolong(u, A, share, levels, level, np.float32(1.0))
        _smooth(u, b, scratch, A, levels, level, 1, False)


@kernel(fastmath=True)
def _full_multigrid(
    u: Floats, b: Floats, scratch: Floats, A: FivePoint, share: Floats, whole: Floats, levels: Ints
) -> None:
    """A start for the finest level by nested iteration: one V-cycle a level, from the coarsest up.

    b holds the ties of every level, traced there, not the restriction of the finest one's.
    """
    given = b.copy()
    for level in range(len(levels) - 1, 0, -1):
        _flat(b, levels[level])[:] = _flat(given, levels[level])
        _v_cycle(u, b, scratch, A, share, levels, level, level == len(levels) - 1)
        _prolong(u, A, whole, levels, level - 1, np.float32(0.0))


@kernel(fastmath=True)
def _dot(a: Floats, b: Floats) -> np.float32:
    total = np.float32(0.0)
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@kernel(fastmath=True)
def _advance(x: Floats, r: Floats, p: Floats, Ap: Floats, alpha: np.float32) -> np.float32:
    """x += α p, r −= α A p; returns the largest change of x."""
    change = np.float32(0.0)
    for i in range(len(x)):
        move = alpha * p[i]
        x[i] += move
        r[i] -= alpha * Ap[i]
        change = max(change, abs(move))
    return change


@kernel(fastmath=True)
def solve(
    u: Floats,
    b: Floats,
    A: FivePoint,
    share: Floats,
    whole: Floats,
    levels: Ints,
    tolerance: np.float32,
    max_cycles: int,
) -> tuple[Floats, int, np.float32]:
    """Solve the finest level: flexible conjugate gradients, preconditioned by one V-cycle from zero.

    u, b: (N,) zeros and right-hand side on all levels; both are overwritten.  share: see `equations.assemble`.
    whole: ones, of the shape of share, for the start, whose blocks' children take all of it.
    Returns (solution of the finest level with its ring, cycles, estimated largest error). The error is the last change
    times ρ / (1 − ρ), ρ the observed contraction.
    """
    scratch, here = np.zeros_like(u), levels[0]
    _full_multigrid(u, b, scratch, A, share, whole, levels)
    # the V-cycle reads r as the finest level's right-hand side and leaves z as its unknowns
    z, r = _flat(u, here), _flat(b, here)
    x, n = z.copy(), len(z)
    p, Ap = np.zeros(n, np.float32), np.zeros(n, np.float32)
    _add_product(x, A, here, np.float32(-1.0), r)  # r = b − A x
    error, last_change, alpha, rz = np.float32(1e30), np.float32(0.0), np.float32(0.0), np.float32(1.0)
    for cycle in range(max_cycles):
        _v_cycle(u, b, scratch, A, share, levels, 0, True)
        beta = -alpha * _dot(z, Ap) / rz  # Polak and Ribière's, as −α A p is the change of r
        for i in range(n):
            p[i] = z[i] + beta * p[i]
        rz = _dot(z, r)
        Ap[:] = np.float32(0.0)
        _add_product(p, A, here, np.float32(1.0), Ap)
        curvature = _dot(p, Ap)
        if curvature <= np.float32(1e-30) or rz == np.float32(0.0):
            return x, cycle + 1, np.float32(0.0)
        alpha = _dot(p, r) / curvature
        change = _advance(x, r, p, Ap, alpha)
        rate = _FIRST_RATE if cycle == 0 else max(change / max(last_change, np.float32(1e-30)), _LEAST_RATE)
        if rate < np.float32(1.0):
            error = change * rate / (np.float32(1.0) - rate)
            if error <= tolerance:
                return x, cycle + 1, error
        last_change = change
    return x, max_cycles, error
