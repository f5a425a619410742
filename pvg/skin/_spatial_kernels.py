"""Compiled kernels of what a cell's place alone says of skin; see `pvg.skin.prior`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pvg._arrays import Floats
from pvg._compiled import kernel
from pvg.skin._kernels import cubic, smoothstep


class SpatialCoefficients(NamedTuple):
    """The log-odds of head, ears and neck as `spatial_fields` computes them.

    A ramp from 0 to 1 is a slope and its value at 0; ears are measured in standard deviations.
    """

    cheek_inside: np.float32
    cheek_most: np.float32
    cheek_outside: np.float32
    forehead_edge: np.float32
    forehead_inside: np.float32
    forehead_most: np.float32
    forehead_outside: np.float32
    forehead_begins: np.float32
    forehead_full: np.float32
    ear_across: np.float32
    ear_center: np.float32
    ear_along: np.float32
    ear_odds: np.float32
    ear_floor: np.float32
    ear_reach: np.float32
    ear_none: np.float32
    neck_begins: np.float32
    neck_none: np.float32
    neck_reach: np.float32
    neck_half_width: np.float32
    neck_widening: np.float32
    neck_edge: np.float32
    neck_axis: np.float32
    neck_fall: np.float32
    neck_head: np.float32
    neck_head_slope: np.float32
    neck_head_at_chin: np.float32
    neck_weight_slope: np.float32
    neck_weight_at_chin: np.float32
    chest_begins: np.float32
    chest_full: np.float32
    chest_fade: np.float32
    least: np.float32
    most: np.float32


class SpatialFields(NamedTuple):
    """What `spatial_fields` writes of every cell, all (h, w) float32.

    log_odds: of skin;  neck: the weight of the neck in [0, 1];  fade: in [0, 1], see `pvg.skin.prior.SpatialPrior`;
    down: depth on the face;  along, off: the way along the neck and the distance off its axis, in sizes;
    ears: the ears' own log-odds.
    """

    log_odds: Floats
    neck: Floats
    fade: Floats
    down: Floats
    along: Floats
    off: Floats
    ears: Floats


@kernel(inline=True)
def _head_log_odds(inside: np.float32, depth: np.float32, brow: np.float32, c: SpatialCoefficients) -> np.float32:
    """Log-odds of skin on the head: strict along cheeks and jaw, lenient at the hair-line.

    inside: signed distance to the contour in face sizes. Fringes and hats reach far below the contour's top, bald
    heads far above it.
    """
    if inside > 0:
        cheeks = min(c.cheek_inside * inside, c.cheek_most)
        forehead = min(c.forehead_edge + c.forehead_inside * inside, c.forehead_most)
    else:
        cheeks, forehead = c.cheek_outside * inside, c.forehead_edge + c.forehead_outside * inside
    above = smoothstep(-depth, -brow - c.forehead_begins, -brow + c.forehead_full)
    return cheeks * (np.float32(1.0) - above) + forehead * above


@kernel(inline=True)
def _ear_log_odds(beside: np.float32, below: np.float32, c: SpatialCoefficients) -> np.float32:
    """Log-odds of skin at the ears, beside the contour (sizes) and between eyes and nose (sizes below that level)."""
    a, b = beside * c.ear_across - c.ear_center, below * c.ear_along
    fall = np.float32(0.5) * (a * a + b * b)
    if fall > c.ear_reach:  # less than is told apart
        return c.ear_none
    log_odds: np.float32 = np.log(c.ear_odds * np.exp(-fall) + c.ear_floor)
    return log_odds


@kernel(inline=True)
def _neck_log_odds(along: np.float32, off: np.float32, c: SpatialCoefficients) -> np.float32:
    """Log-odds of skin on the neck: sure under the chin, open towards a collar, widening to the shoulders."""
    if along <= -c.neck_begins:
        return c.neck_none
    below = min(max(along, np.float32(0.0)), c.neck_reach)
    inside = c.neck_half_width + c.neck_widening * below * np.sqrt(below) - off
    log_odds: np.float32 = min(c.neck_axis - c.neck_fall * below, inside * c.neck_edge)
    return log_odds - c.neck_head * cubic(c.neck_head_at_chin - c.neck_head_slope * along)


@kernel(inline=True)
def _sides(along: np.float32, off: np.float32, c: SpatialCoefficients) -> np.float32:
    """1 on head and neck, falling to 0 across the edge of a bare chest, where nothing in the picture ends."""
    below = min(max(along, np.float32(0.0)), c.neck_reach)
    inside = c.neck_half_width + c.neck_widening * below * np.sqrt(below) - off
    chest = smoothstep(along, c.chest_begins, c.chest_full)
    return np.float32(1.0) - chest * (np.float32(1.0) - smoothstep(inside, -c.chest_fade, c.chest_fade))


@kernel(fastmath=True)
def spatial_fields(
    inner: Floats,
    outer: Floats,
    frame: Floats,
    brow: np.float32,
    ear: np.float32,
    fade_ends: Floats,
    coefficients: SpatialCoefficients,
    out: SpatialFields,
) -> None:
    """What `pvg.skin.prior.spatial_prior` tells of every cell (h, w) by its place alone.

    inner, outer: float32 distances from the contour within and outside it, in cells;
    frame: (12,) float32: 0 the oval's middle, 2 across, 4 down, 6 chin, 8 neck (x, y each), 10 size, 11 width;
    brow, ear: depths of brows and ears in sizes;  fade_ends: (3,) where the neck's fade begins and ends,
    and the width of the fade along the raster's sides, in sizes.
    """
    log_odds, neck, fade, down, along, off, ears = out
    h, w = log_odds.shape
    size, half_width = frame[10], frame[11] / frame[10] / np.float32(2.0)
    one = np.float32(1.0)
    for i in range(h):
        y, chin_y = (np.float32(i) - frame[1]) / size, (np.float32(i) - frame[7]) / size
        for j in range(w):
            x, chin_x = (np.float32(j) - frame[0]) / size, (np.float32(j) - frame[6]) / size
            side, depth = x * frame[2] + y * frame[3], x * frame[4] + y * frame[5]
            way, away = chin_x * frame[8] + chin_y * frame[9], abs(chin_x * frame[9] - chin_y * frame[8])
            at_ear = _ear_log_odds(abs(side) - half_width, depth - ear, coefficients)
            on_head = _head_log_odds((inner[i, j] - outer[i, j]) / size, depth, brow, coefficients)
            most = max(on_head, at_ear, _neck_log_odds(way, away, coefficients))
            log_odds[i, j] = min(max(most, coefficients.least), coefficients.most)
            neck[i, j] = cubic(coefficients.neck_weight_slope * way + coefficients.neck_weight_at_chin)
            fade[i, j] = (one - smoothstep(way, fade_ends[0], fade_ends[1])) * _sides(way, away, coefficients)
            fade[i, j] *= cubic(np.float32(min(i, h - 1 - i, j, w - 1 - j)) / (size * fade_ends[2]))
            down[i, j], along[i, j], off[i, j], ears[i, j] = depth, way, away, at_ear
