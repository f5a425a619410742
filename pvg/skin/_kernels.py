# Compiled functions take their types from the first call.
# mypy: disable-error-code="no-untyped-def, untyped-decorator, no-untyped-call"
"""Compiled kernels of what is computed for every cell of every frame."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, fastmath=True)
def mixture_share(color, own, hair, precision, least, width, out):
    """out (h, w) = t of color = (1 − t) own + t hair for (h, w, 3) colours; see `pvg.skin.veil`.

    hair: (3,);  precision: (3, 3) symmetric;  least: squared contrast below which a line has no direction;
    width: how far, over the contrast, a mixture lies off the line.
    """
    h, w = out.shape
    none, most = np.float32(0.0), np.float32(1.2)
    p00, p01, p02 = precision[0, 0], precision[0, 1], precision[0, 2]
    p11, p12, p22 = precision[1, 1], precision[1, 2], precision[2, 2]
    for i in range(h):
        for j in range(w):
            x, y, z = hair[0] - own[i, j, 0], hair[1] - own[i, j, 1], hair[2] - own[i, j, 2]
            u, v, s = p00 * x + p01 * y + p02 * z, p01 * x + p11 * y + p12 * z, p02 * x + p12 * y + p22 * z
            length = max(u * x + v * y + s * z, least)
            a, b, c = color[i, j, 0] - own[i, j, 0], color[i, j, 1] - own[i, j, 1], color[i, j, 2] - own[i, j, 2]
            share = min(max((a * u + b * v + c * s) / length, none), most)
            if share > none:
                a, b, c = a - share * x, b - share * y, c - share * z
                off = (
                    p00 * a * a
                    + p11 * b * b
                    + p22 * c * c
                    + np.float32(2.0) * (p01 * a * b + p02 * a * c + p12 * b * c)
                )
                share *= np.exp(-off / (length * width * width))
            out[i, j] = share


@njit(cache=True, nogil=True, fastmath=True)
def level_chroma(lab, lightness, darkest):
    """Bring a and b of lab (h, w, 3) to one lightness, in place; see `pvg.skin.colors.to_skin_lab`."""
    offset = np.float32(16.0)
    for i in range(lab.shape[0]):
        for j in range(lab.shape[1]):
            scale = (lightness + offset) / (max(lab[i, j, 0], darkest) + offset)
            lab[i, j, 1] *= scale
            lab[i, j, 2] *= scale


@njit(cache=True, nogil=True, fastmath=True)
def skin_share(lab, center, scale, reach, bins, table, sure, prior, neckness, inside, covered, veil_odds, out):
    """out (h, w) = probability of skin of every cell; see `pvg.skin.tracking`.

    lab: (h, w, 3);  center, scale: (3,), bins of `table` are (lab − center) · scale + reach;
    inside: signed distance to the carried edge;  covered: (h, w) veil.
    """
    h, w = out.shape
    none, top = np.float32(0.0), np.float32(bins - 1)
    for i in range(h):
        for j in range(w):
            index = 0
            for k in range(3):
                place = (lab[i, j, k] - center[k]) * scale[k] + reach
                index = index * bins + int(min(max(place, none), top))
            evidence = table[index]
            if sure[i, j]:
                evidence = max(evidence, none)
            carried = min(max(inside[i, j] * np.float32(60.0), np.float32(-6.0)), np.float32(6.0))
            carried *= np.float32(1.0) - np.float32(0.6) * neckness[i, j]
            odds = np.float32(0.6) * prior[i, j] + carried + evidence - veil_odds * covered[i, j]
            out[i, j] = np.float32(1.0) / (np.float32(1.0) + np.exp(-odds))


@njit(nogil=True, inline="always")
def _rise(x, low, high):
    """0 below `low`, 1 above `high`, smooth between."""
    t = min(max((x - low) / (high - low), np.float32(0.0)), np.float32(1.0))
    return t * t * (np.float32(3.0) - np.float32(2.0) * t)


@njit(nogil=True, inline="always")
def _off_line(a, b, tone, most):
    """How far a colour's a and b, in spreads, are off the line from 0 to `most` times `tone` (2,)."""
    length = max(tone[0] * tone[0] + tone[1] * tone[1], np.float32(1e-6))
    along = min(max((a * tone[0] + b * tone[1]) / length, np.float32(0.0)), most)
    a, b = a - along * tone[0], b - along * tone[1]
    return np.sqrt(a * a + b * b)


@njit(cache=True, nogil=True, fastmath=True)
def off_hue(lab, tone, spread, most, out):
    """out (h, w) = how far colours (h, w, 3) are off the skin's line of hue, in spreads; see `foreign_share`."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = _off_line(lab[i, j, 1] / spread[0], lab[i, j, 2] / spread[1], tone, most)


@njit(cache=True, nogil=True, fastmath=True)
def foreign_share(lab, cells, tone, spread, most, bounds, darkest, out):
    """out (h, w) = how surely colours (h, w, 3) are off the skin's line of hue, 0 but in `cells` (h, w) bool.

    tone, spread: (2,) the skin's a and b in spreads, and those;  most: the end of the line, times `tone`;
    bounds, darkest: (2,) where the share rises from 0 to 1, in spreads off the line and in L.
    """
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = np.float32(0.0)
            if not cells[i, j]:
                continue
            distance = _off_line(lab[i, j, 1] / spread[0], lab[i, j, 2] / spread[1], tone, most)
            off = _rise(distance, bounds[0], bounds[1])
            if off > np.float32(0.0):
                out[i, j] = off * _rise(lab[i, j, 0], darkest[0], darkest[1])


@njit(nogil=True, inline="always")
def _head_odds(inside, down, brow):
    """Log-odds of skin on the head: strict along cheeks and jaw, lenient at the hair-line.

    inside: signed distance to the contour in sizes. Fringes and hats reach far below the contour's top, bald heads far
    above it.
    """
    if inside > 0:
        cheeks = min(np.float32(40.0) * inside, np.float32(6.0))
        forehead = min(np.float32(0.3) + np.float32(8.0) * inside, np.float32(1.8))
    else:
        cheeks, forehead = np.float32(30.0) * inside, np.float32(0.3) + np.float32(11.0) * inside
    above = _rise(-down, -brow - np.float32(0.15), -brow + np.float32(0.08))
    return cheeks * (np.float32(1.0) - above) + forehead * above


@njit(nogil=True, inline="always")
def _ear_odds(beside, below):
    """Log-odds of skin at the ears, beside the contour (sizes) and between eyes and nose (sizes below that level)."""
    a, b = (beside - np.float32(0.07)) / np.float32(0.08), below / np.float32(0.16)
    fall = np.float32(0.5) * (a * a + b * b)
    if fall > np.float32(8.0):  # less than is told apart
        return np.float32(-9.2)
    return np.log(np.float32(1.2) * np.exp(-fall) + np.float32(1e-4))


@njit(nogil=True, inline="always")
def _neck_odds(along, off):
    """Log-odds of skin on the neck: sure under the chin, open towards a collar, widening to the shoulders."""
    if along <= np.float32(-0.45):
        return np.float32(-9.0)
    below = min(max(along, np.float32(0.0)), np.float32(2.0))
    wide = np.float32(0.40) + np.float32(0.30) * below * np.sqrt(below) - off
    odds = min(np.float32(1.0) - np.float32(0.6) * below, wide * np.float32(14.0))
    return odds - np.float32(12.0) * _rise(-along, np.float32(0.35), np.float32(0.6))


@njit(cache=True, nogil=True, fastmath=True)
def place_fields(inner, outer, frame, brow, level, ends, prior, neckness, fade, down, along, off, ears):
    """What `pvg.skin.zones.locate` tells of every cell (h, w) by its place alone.

    inner, outer: float32 distances from the contour within and outside it, in cells;
    frame: (12,) float32, centre, across, down, chin and neck (x, y each), size and width of the face;
    brow, level: depths of brows and ears in sizes;  ends: where the neck's fade begins and ends.
    Written: prior, the log-odds of skin;  neckness;  fade;  down, depth on the face;  along and off, the way along the
    neck and the distance off its axis, in sizes;  ears, the ears' own log-odds.
    """
    h, w = prior.shape
    size, half_width = frame[10], frame[11] / frame[10] / np.float32(2.0)
    one = np.float32(1.0)
    for i in range(h):
        y, chin_y = (np.float32(i) - frame[1]) / size, (np.float32(i) - frame[7]) / size
        for j in range(w):
            x, chin_x = (np.float32(j) - frame[0]) / size, (np.float32(j) - frame[6]) / size
            side, depth = x * frame[2] + y * frame[3], x * frame[4] + y * frame[5]
            way, away = chin_x * frame[8] + chin_y * frame[9], abs(chin_x * frame[9] - chin_y * frame[8])
            ear = _ear_odds(abs(side) - half_width, depth - level)
            head = _head_odds((inner[i, j] - outer[i, j]) / size, depth, brow)
            odds = max(head, ear, _neck_odds(way, away))
            prior[i, j] = min(max(odds, np.float32(-7.0)), np.float32(6.0))
            neckness[i, j] = _rise(way, np.float32(-0.2), np.float32(0.1))
            fade[i, j] = one - _rise(way, ends[0], ends[1])
            down[i, j], along[i, j], off[i, j], ears[i, j] = depth, way, away, ear
