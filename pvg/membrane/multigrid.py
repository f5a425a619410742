# Compiled functions take their types from the first call.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, no-untyped-call"
"""Compiled kernels of the membrane solver: edge cuts, the grid hierarchy and V-cycles.

The hierarchy lives in flat arrays, one level after the other, finest first. A level is a block of (h + 2) × (w + 2)
numbers with h and w even; the outer ring is zero, so that no loop needs a test at the border. `levels` holds
(offset, h, w, rows, columns) of each, the last two counting the nodes in use. A node of a coarser level is the
centre of a 2 × 2 block of the finer one. γ is traced anew on every level, so each is a true discretisation with
cut edges and not an average of the finer one:

    (Σ edges + tie) u − Σ edge·neighbour = b.

`east` and `south` are the weights of the edges to the right and down, `tie` the sum of 1/θ over a node's cut edges,
`diagonal` the sum of all and `inverse` its reciprocal (zero at nodes outside the domain, which keeps u zero there).
The kernels of the solver assume finite numbers (fastmath), which lets sums and maxima use vector registers.
"""

from __future__ import annotations

import numpy as np
from numba import njit

# Two Jacobi steps with the Chebyshev weights for the eigenvalues [0.5, 2] damp the high half of the spectrum to
# 0.22, like one red-black Gauss-Seidel sweep, and vectorise.
_OMEGA_1 = np.float32(1.0 / (1.25 + 0.75 * np.sqrt(0.5)))
_OMEGA_2 = np.float32(1.0 / (1.25 - 0.75 * np.sqrt(0.5)))

_LEAST_RATE = np.float32(0.35)


@njit(cache=True, nogil=True)
def cut_edges(points, start, stop, levels, size):
    """Nearest crossing of γ on each of a node's four edges (right, left, down, up), on every level.

    points: (S, 2) float64 in steps of the finest level;  start, stop: first and last sample of each segment.
    Returns theta (4, size) float32 distance in steps of the level, inf where the edge is whole; source (4, size)
    int32 segment; place (4, size) float32 along the segment. Crossings use half-open intervals, so a polyline
    through a node or along a row of nodes still separates its two sides.
    """
    theta = np.full((4, size), np.inf, np.float32)
    source = np.zeros((4, size), np.int32)
    place = np.zeros((4, size), np.float32)
    scale = 1.0
    for level in range(len(levels)):
        offset, _, w, rows, columns = levels[level]
        for segment in range(len(start)):
            x0, y0 = (points[start[segment]] + 0.5) * scale - 0.5
            x1, y1 = (points[stop[segment]] + 0.5) * scale - 0.5
            for axis in range(2):  # rows of nodes, then columns
                if axis == 0:
                    a0, b0, a1, b1, lines, nodes = x0, y0, x1, y1, rows, columns
                    stride, across = 1, w + 2
                else:
                    a0, b0, a1, b1, lines, nodes = y0, x0, y1, x1, columns, rows
                    stride, across = w + 2, 1
                first = max(0, int(np.ceil(min(max(min(b0, b1), -1.0), lines))))
                last = min(lines - 1, int(np.ceil(min(max(b0, b1, -1.0), lines))) - 1)
                for line in range(first, last + 1):
                    along = (line - b0) / (b1 - b0)
                    crossing = a0 + along * (a1 - a0)
                    if crossing < 0.0 or crossing > nodes - 1 or nodes < 2:
                        continue
                    node = min(int(crossing), nodes - 2)
                    index = offset + w + 3 + line * across + node * stride
                    for end in range(2):
                        distance = np.float32(crossing - node if end == 0 else node + 1 - crossing)
                        at = index + end * stride
                        if distance < theta[2 * axis + end, at]:
                            theta[2 * axis + end, at] = distance
                            source[2 * axis + end, at] = segment
                            place[2 * axis + end, at] = along
        scale *= 0.5
    return theta, source, place


@njit(cache=True, nogil=True)
def _occupied(domain, levels, size):
    """1 at the nodes of the domain on every level, else 0: a block belongs to it when one of its children does."""
    inside = np.zeros(size, np.float32)
    for level in range(len(levels)):
        offset, _, w, rows, columns = levels[level]
        fine, wf = levels[max(level - 1, 0), 0], levels[max(level - 1, 0), 2]
        for y in range(rows):
            for x in range(columns):
                i = offset + (y + 1) * (w + 2) + x + 1
                if level == 0:
                    inside[i] = np.float32(1.0) if domain[y, x] else np.float32(0.0)
                else:
                    k = fine + (2 * y + 1) * (wf + 2) + 2 * x + 1
                    inside[i] = max(inside[k], inside[k + 1], inside[k + wf + 2], inside[k + wf + 3])
    return inside


@njit(cache=True, nogil=True)
def assemble(theta, domain, levels, smallest, size):
    """Edges, ties, diagonals and the shares of a block's children, on every level.

    domain: (rows, columns) bool of the finest level.  smallest: lower bound of θ.
    Returns (east, south, tie, diagonal, inverse) and share: (4, size), for the children to the right, left, below
    and above of a block centre. A correction falls linearly to zero at a cut, so a child a quarter step away keeps
    1 − ¼/θ of it.
    """
    east, south, tie = np.zeros(size, np.float32), np.zeros(size, np.float32), np.zeros(size, np.float32)
    diagonal, inverse = np.zeros(size, np.float32), np.zeros(size, np.float32)
    share = np.ones((4, size), np.float32)
    inside = _occupied(domain, levels, size)
    one, none = np.float32(1.0), np.float32(0.0)
    for level in range(len(levels)):
        offset, _, w, rows, columns = levels[level]
        fine, wf = levels[max(level - 1, 0), 0], levels[max(level - 1, 0), 2]
        for y in range(rows):
            for x in range(columns):
                i = offset + (y + 1) * (w + 2) + x + 1
                if inside[i] == none:
                    continue
                east[i] = inside[i + 1] if theta[0, i] == np.inf else none
                south[i] = inside[i + w + 2] if theta[2, i] == np.inf else none
                for side in range(4):
                    if theta[side, i] < np.inf:
                        weight = one / max(theta[side, i], smallest)
                        tie[i] += weight
                        share[side, i] = max(none, one - np.float32(0.25) * weight)
                if level > 0:
                    # A curve that runs between the children, unseen from their centre, must hold the block as
                    # firmly as it holds them: else the correction of the block overshoots and diverges.
                    k = fine + (2 * y + 1) * (wf + 2) + 2 * x + 1
                    right, left, low, up = share[0, i] ** 2, share[1, i] ** 2, share[2, i] ** 2, share[3, i] ** 2
                    upper = left * tie[k] + right * tie[k + 1]
                    lower = left * tie[k + wf + 2] + right * tie[k + wf + 3]
                    tie[i] = max(tie[i], up * upper + low * lower)
                # the edges to the left and above belong to nodes already done
                diagonal[i] = east[i] + east[i - 1] + south[i] + south[i - w - 2] + tie[i]
                inverse[i] = one / diagonal[i] if diagonal[i] > none else none
    return (east, south, tie, diagonal, inverse), share


@njit(cache=True, nogil=True, fastmath=True)
def _flat(array, level):
    """The numbers of a level in an array of one channel over all levels."""
    o, h, w = level[0], level[1], level[2]
    return array[o : o + (h + 2) * (w + 2)]


@njit(cache=True, nogil=True, fastmath=True)
def _block(array, level):
    """The same as (h + 2, w + 2)."""
    return _flat(array, level).reshape((level[1] + 2, level[2] + 2))


@njit(cache=True, nogil=True, fastmath=True)
def _jacobi(u, b, east, south, inverse, width, omega, out):
    """out = u + ω (inverse (b + Σ edge·neighbour) − u).

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


@njit(cache=True, nogil=True, fastmath=True)
def _smooth(u, b, spare, parts, levels, level, sweeps, from_zero):
    """Pairs of Jacobi steps on a level, by way of `spare`, whose rings are zero; u is not read if `from_zero`."""
    here = levels[level]
    x, rhs, t = _flat(u, here), _flat(b, here), _flat(spare, here)
    east, south, inverse = _flat(parts[0], here), _flat(parts[1], here), _flat(parts[4], here)
    width = here[2] + 2
    for sweep in range(sweeps):
        if from_zero and sweep == 0:
            for i in range(len(x)):
                t[i] = _OMEGA_1 * inverse[i] * rhs[i]
        else:
            _jacobi(x, rhs, east, south, inverse, width, _OMEGA_1, t)
        _jacobi(t, rhs, east, south, inverse, width, _OMEGA_2, x)


@njit(cache=True, nogil=True, fastmath=True)
def _apply(u, parts, here, sign, out):
    """out += sign · A u on a level."""
    east, south, diagonal = _flat(parts[0], here), _flat(parts[1], here), _flat(parts[3], here)
    width = here[2] + 2
    first, last = width, len(u) - width
    row, up, below = u[first:last], u[: last - width], u[first + width :]
    left, right = u[first - 1 : last - 1], u[first + 1 : last + 1]
    ee, ew, ss, sn = east[first:last], east[first - 1 : last - 1], south[first:last], south[: last - width]
    d, to = diagonal[first:last], out[first:last]
    for i in range(last - first):
        near = ee[i] * right[i] + ew[i] * left[i] + ss[i] * below[i] + sn[i] * up[i]
        to[i] += sign * (d[i] * row[i] - near)


@njit(cache=True, nogil=True, fastmath=True)
def _descend(u, b, spare, parts, share, levels, level):
    """The next level's b = sums over 2 × 2 blocks of b − A u, each child with its share of the block's correction."""
    here, coarser = levels[level], levels[level + 1]
    rest = _flat(spare, here)
    rest[:] = _flat(b, here)
    _apply(_flat(u, here), parts, here, np.float32(-1.0), rest)
    fine, coarse = _block(spare, here), _block(b, coarser)
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
    _clear_rings(fine)


@njit(cache=True, nogil=True, fastmath=True)
def _clear_rings(block):
    block[0], block[-1] = np.float32(0.0), np.float32(0.0)
    block[:, 0], block[:, -1] = np.float32(0.0), np.float32(0.0)


@njit(cache=True, nogil=True, fastmath=True)
def _ascend(u, parts, share, levels, level, keep):
    """u = keep·u + the interpolation of the block centres, bilinear along whole edges, falling to zero at cuts."""
    here, coarser = levels[level], levels[level + 1]
    coarse, fine = _block(u, coarser), _block(u, here)
    east, south, inverse = _block(parts[0], coarser), _block(parts[1], coarser), _block(parts[4], here)
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
        row, before, after = coarse[yc, 1 : half + 1], coarse[yc, 0:half], coarse[yc, 2 : half + 2]
        ee, ew = east[yc, 1 : half + 1], east[yc, 0:half]
        sr, sl, v, to = right[yc, 1 : half + 1], left[yc, 1 : half + 1], inverse[y, 1:], fine[y, 1:]
        for x in range(half):
            middle = sy[x] * row[x] + q * edge[x] * (other[x] - row[x])
            # the slope along the row is taken at the centre; the mixed term of the bilinear form is left out
            west = sl[x] * middle + q * ew[x] * (before[x] - row[x])
            easterly = sr[x] * middle + q * ee[x] * (after[x] - row[x])
            to[2 * x] = keep * to[2 * x] + (west if v[2 * x] > none else none)
            to[2 * x + 1] = keep * to[2 * x + 1] + (easterly if v[2 * x + 1] > none else none)


@njit(cache=True, nogil=True, fastmath=True)
def _cycle(u, b, spare, parts, share, levels, top, from_zero):
    """One V(2, 2)-cycle from level `top` down."""
    last = len(levels) - 1
    for level in range(top, last):
        _smooth(u, b, spare, parts, levels, level, 1, from_zero or level > top)
        _descend(u, b, spare, parts, share, levels, level)
    # the last level is at most a few nodes across, but may be long
    sweeps = 8 + max(levels[last, 1], levels[last, 2]) ** 2 // 8
    _smooth(u, b, spare, parts, levels, last, sweeps, from_zero or last > top)
    for level in range(last - 1, top - 1, -1):
        _ascend(u, parts, share, levels, level, np.float32(1.0))
        _smooth(u, b, spare, parts, levels, level, 1, False)


@njit(cache=True, nogil=True, fastmath=True)
def _nested_start(u, b, spare, parts, share, whole, levels):
    """A start for the finest level: one V-cycle a level, from the coarsest up."""
    given = b.copy()
    for level in range(len(levels) - 1, 0, -1):
        _flat(b, levels[level])[:] = _flat(given, levels[level])
        _cycle(u, b, spare, parts, share, levels, level, level == len(levels) - 1)
        _ascend(u, parts, whole, levels, level - 1, np.float32(0.0))


@njit(cache=True, nogil=True, fastmath=True)
def _dot(a, b):
    total = np.float32(0.0)
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@njit(cache=True, nogil=True, fastmath=True)
def _step(u, r, p, q, alpha):
    """u += α p, r −= α q; returns the largest change of u."""
    change = np.float32(0.0)
    for i in range(len(u)):
        move = alpha * p[i]
        u[i] += move
        r[i] -= alpha * q[i]
        change = max(change, abs(move))
    return change


@njit(cache=True, nogil=True, fastmath=True)
def solve(u, b, parts, share, whole, levels, warm, tolerance, max_cycles):
    """Solve the finest level: flexible conjugate gradients, preconditioned by one V-cycle from zero.

    u, b: (N,) start (if warm) and right-hand side on all levels; both are overwritten. parts: (east, south, tie,
    diagonal, inverse). whole: ones, of the shape of share. Returns (solution of the finest level with its ring, cycles,
    estimated largest error). The error is the last change times ρ / (1 − ρ), ρ the observed contraction.
    """
    spare, here = np.zeros_like(u), levels[0]
    if not warm:
        _nested_start(u, b, spare, parts, share, whole, levels)
    z, r = _flat(u, here), _flat(b, here)
    solution, n = z.copy(), len(z)
    p, q = np.zeros(n, np.float32), np.zeros(n, np.float32)
    _apply(solution, parts, here, np.float32(-1.0), r)
    error, last_change, alpha, power = np.float32(1e30), np.float32(0.0), np.float32(0.0), np.float32(1.0)
    for cycle in range(max_cycles):
        _cycle(u, b, spare, parts, share, levels, 0, True)
        beta = -alpha * _dot(z, q) / power
        for i in range(n):
            p[i] = z[i] + beta * p[i]
        power = _dot(z, r)
        q[:] = np.float32(0.0)
        _apply(p, parts, here, np.float32(1.0), q)
        bend = _dot(p, q)
        if bend <= np.float32(1e-30) or power == np.float32(0.0):
            return solution, cycle + 1, np.float32(0.0)
        alpha = _dot(p, r) / bend
        change = _step(solution, r, p, q, alpha)
        # The first cycles look faster than the lasting rate, and the very first has no predecessor.
        rate = np.float32(0.5) if cycle == 0 else max(change / max(last_change, np.float32(1e-30)), _LEAST_RATE)
        if rate < np.float32(1.0):
            error = change * rate / (np.float32(1.0) - rate)
            if error <= tolerance:
                return solution, cycle + 1, error
        last_change = change
    return solution, max_cycles, error


@njit(cache=True, nogil=True)
def tie_values(samples, start, stop, place):
    """(C, E) values at the ties, linear between the samples (S, C) float32 they lie between."""
    out = np.empty((samples.shape[1], len(start)), np.float32)
    for e in range(len(start)):
        for c in range(samples.shape[1]):
            first = samples[start[e], c]
            out[c, e] = first + place[e] * (samples[stop[e], c] - first)
    return out


@njit(cache=True, nogil=True, fastmath=True)
def load(node, weight, values, middle, inverse, b):
    """b = Σ weight·(value − middle) over the ties of each node of the domain, on all levels."""
    b[:] = np.float32(0.0)
    for e in range(len(node)):
        if inverse[node[e]] > np.float32(0.0):
            b[node[e]] += weight[e] * (values[e] - middle)
