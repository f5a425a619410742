"""Compiled kernels of what is computed for every cell of every frame.

They compute; checks and allocation are their callers'. All their numbers are float32, and what is tuned comes as an
argument: `PosteriorWeights` and `BodyWeights` hold what `pvg.skin.parameters` says in the form computed with.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Bools, Bytes, Doubles, Floats
from pvg._compiled import kernel

_CIE_OFFSET = np.float32(16.0)  # of CIE lightness, L* = 116 f(Y) − 16


class ColorOdds(NamedTuple):
    """Log-likelihood ratios of colours, binned.

    table: (bins³,) over the bins (lab − center) · scale + middle, center and scale (3,).
    """

    table: Floats
    center: Floats
    scale: Floats
    middle: np.float32
    bins: int


class CellEvidence(NamedTuple):
    """What is known of every cell beside its colour, all (h, w) float32.

    prior: log-odds;  neck: in [0, 1];
    distance: signed distance to the carried edge in face sizes;  hair: cover in [0, 1].
    """

    prior: Floats
    neck: Floats
    distance: Floats
    hair: Floats


class HueLine(NamedTuple):
    """The skin's hues in any light: from grey to `most` times its tone.

    tone, spread: (2,) the skin's a and b in spreads, and those spreads.
    """

    tone: Floats
    spread: Floats
    most: np.float32


class PosteriorWeights(NamedTuple):
    """Weights of what `skin_probability` adds up, in nats; see `pvg.skin.parameters.TrackingNumbers`."""

    prior: np.float32
    shape_slope: np.float32
    shape_most: np.float32
    neck_release: np.float32
    hair: np.float32


@kernel(fastmath=True)
def hair_fraction(
    color: Floats,
    skin: Floats,
    hair: Floats,
    precision: Floats,
    least_contrast: np.float32,
    line_width: np.float32,
    most: np.float32,
    out: Floats,
) -> None:
    """out (h, w) = t of the mixture color = (1 − t) skin + t hair, (h, w, 3) colours; see `pvg.skin.hair.hair_cover`.

    hair: (3,);  precision: (3, 3) symmetric, P of the squared Mahalanobis length vᵀP v;
    least_contrast: least of that of hair − skin, below which the line between them has no direction;
    line_width: standard deviation of mixtures from that line, over the contrast;  most: upper limit of t.
    """
    h, w = out.shape
    none = np.float32(0.0)
    p00, p01, p02 = precision[0, 0], precision[0, 1], precision[0, 2]
    p11, p12, p22 = precision[1, 1], precision[1, 2], precision[2, 2]
    for i in range(h):
        for j in range(w):
            x, y, z = hair[0] - skin[i, j, 0], hair[1] - skin[i, j, 1], hair[2] - skin[i, j, 2]
            u, v, s = p00 * x + p01 * y + p02 * z, p01 * x + p11 * y + p12 * z, p02 * x + p12 * y + p22 * z
            contrast = max(u * x + v * y + s * z, least_contrast)
            a, b, c = color[i, j, 0] - skin[i, j, 0], color[i, j, 1] - skin[i, j, 1], color[i, j, 2] - skin[i, j, 2]
            t = min(max((a * u + b * v + c * s) / contrast, none), most)
            if t > none:
                a, b, c = a - t * x, b - t * y, c - t * z
                off_line = (
                    p00 * a * a
                    + p11 * b * b
                    + p22 * c * c
                    + np.float32(2.0) * (p01 * a * b + p02 * a * c + p12 * b * c)
                )
                t *= np.exp(-off_line / (contrast * line_width * line_width))
            out[i, j] = t


@kernel()
def level_quantiles(rgb: Bytes, sample: Bools, shares: Doubles, out: Doubles) -> int:
    """out (n, 3) = quantiles of each channel of rgb (h, w, 3) where `sample` (h, w) is; the number of such cells.

    shares: (n,) in [0, 1], 0.5 of a median. By counting levels: sorting them takes ten times as long. Between two
    levels a quantile is half-way; of no cells it is 0.
    """
    counts = np.zeros((3, 256), np.int64)
    total = 0
    for i in range(sample.shape[0]):
        for j in range(sample.shape[1]):
            if sample[i, j]:
                total += 1
                for k in range(3):
                    counts[k, rgb[i, j, k]] += 1
    if total == 0:
        out[:] = 0.0
        return 0
    for n in range(len(shares)):
        at = shares[n] * (total - 1)
        for k in range(3):
            out[n, k] = 0.0
            for place in (int(np.floor(at)), int(np.ceil(at))):
                level, below = 0, counts[k, 0]
                while below <= place and level < 255:
                    level += 1
                    below += counts[k, level]
                out[n, k] += 0.5 * level
    return total


@kernel(fastmath=True)
def normalize_chroma(lab: Floats, lightness: np.float32, darkest: np.float32) -> None:
    """Bring a and b of lab (h, w, 3) to one lightness, in place; see `pvg.skin.color_model.to_skin_lab`."""
    for i in range(lab.shape[0]):
        for j in range(lab.shape[1]):
            scale = (lightness + _CIE_OFFSET) / (max(lab[i, j, 0], darkest) + _CIE_OFFSET)
            lab[i, j, 1] *= scale
            lab[i, j, 2] *= scale


@kernel(fastmath=True)
def skin_probability(
    lab: Floats, colors: ColorOdds, cells: CellEvidence, weights: PosteriorWeights, out: Floats
) -> None:
    """out (h, w) = posterior probability of skin of every cell of colours lab (h, w, 3); see `pvg.skin.tracking`."""
    table, center, scale, middle, bins = colors
    prior, neck, distance, hair = cells
    h, w = out.shape
    none, top = np.float32(0.0), np.float32(bins - 1)
    for i in range(h):
        for j in range(w):
            index = 0
            for k in range(3):
                place = (lab[i, j, k] - center[k]) * scale[k] + middle
                index = index * bins + int(min(max(place, none), top))
            shape = min(max(distance[i, j] * weights.shape_slope, -weights.shape_most), weights.shape_most)
            against_shape = shape * (weights.neck_release * neck[i, j] - np.float32(1.0))
            against = -weights.prior * prior[i, j] - table[index] + weights.hair * hair[i, j] + against_shape
            out[i, j] = np.float32(1.0) / (np.float32(1.0) + np.exp(against))


@kernel(inline=True)
def cubic(t: np.float32) -> np.float32:
    """0 below 0, 1 above 1, smooth between."""
    t = min(max(t, np.float32(0.0)), np.float32(1.0))
    return t * t * (np.float32(3.0) - np.float32(2.0) * t)


@kernel(inline=True)
def smoothstep(x: np.float32, low: np.float32, high: np.float32) -> np.float32:
    """0 below `low`, 1 above `high`, smooth between."""
    return cubic((x - low) / (high - low))


@kernel(inline=True)
def _hue_distance(a: np.float32, b: np.float32, tone: Floats, most: np.float32) -> np.float32:
    """How far a colour's a and b, in spreads, are off the line from 0 to `most` times `tone` (2,)."""
    length = max(tone[0] * tone[0] + tone[1] * tone[1], np.float32(1e-6))
    along = min(max((a * tone[0] + b * tone[1]) / length, np.float32(0.0)), most)
    a, b = a - along * tone[0], b - along * tone[1]
    distance: np.float32 = np.sqrt(a * a + b * b)
    return distance


@kernel(fastmath=True)
def hue_distance(lab: Floats, line: HueLine, out: Floats) -> None:
    """out (h, w) = how far colours (h, w, 3) are off the skin's hue line, in spreads; see `occluder_alpha`."""
    tone, spread, most = line
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = _hue_distance(lab[i, j, 1] / spread[0], lab[i, j, 2] / spread[1], tone, most)


@kernel(fastmath=True)
def foreign_hue(lab: Floats, cells: Bools, line: HueLine, bounds: Floats, darkest: Floats, out: Floats) -> None:
    """out (h, w) = how surely colours (h, w, 3) are off the skin's hue line, in [0, 1]; 0 but in `cells` (h, w).

    bounds, darkest: (2,) where the certainty rises from 0 to 1, in spreads off the line and in L.
    """
    tone, spread, most = line
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = np.float32(0.0)
            if not cells[i, j]:
                continue
            distance = _hue_distance(lab[i, j, 1] / spread[0], lab[i, j, 2] / spread[1], tone, most)
            foreign = smoothstep(distance, bounds[0], bounds[1])
            if foreign > np.float32(0.0):
                out[i, j] = foreign * smoothstep(lab[i, j, 0], darkest[0], darkest[1])


class BodyWeights(NamedTuple):
    """What `body_log_odds` adds up, in nats; see `pvg.skin.parameters.BodyNumbers`."""

    person: np.float32
    person_for: np.float32
    no_person: np.float32
    head: np.float32
    head_begins: np.float32
    head_ends: np.float32
    texture_from: np.float32
    texture: np.float32
    texture_dark: np.float32
    ear_beside: np.float32
    ear_width: np.float32
    ear_height: np.float32
    ear_reach: np.float32
    ear_rise: np.float32
    ear_bare: np.float32
    ear_release: np.float32
    ear_begins: np.float32
    ear_ends: np.float32
    neck: np.float32
    neck_begins: np.float32
    neck_ends: np.float32
    most: np.float32


@kernel(inline=True)
def _of_cube(cube: Floats, at: NDArray[np.int32], share: Floats) -> np.float32:
    """Of a cube (n, n, n), read linearly between the node `at` (3,) and the next ones, by `share` (3,) of the way."""
    r, g, b = at[0], at[1], at[2]
    u, v, s = share[0], share[1], share[2]
    one = np.float32(1.0)
    near = (cube[r, g, b] * (one - s) + cube[r, g, b + 1] * s) * (one - v) + (
        cube[r, g + 1, b] * (one - s) + cube[r, g + 1, b + 1] * s
    ) * v
    far = (cube[r + 1, g, b] * (one - s) + cube[r + 1, g, b + 1] * s) * (one - v) + (
        cube[r + 1, g + 1, b] * (one - s) + cube[r + 1, g + 1, b + 1] * s
    ) * v
    value: np.float32 = near + u * (far - near)
    return value


@kernel(fastmath=True)
def body_log_odds(
    rgb: Bytes,
    person: Bytes,
    face_mask: Floats,
    against: Floats,
    cube: Floats,
    ears: Floats,
    gain: Floats,
    frame: Floats,
    weights: BodyWeights,
    out: Floats,
) -> None:
    """out (h, w) = log-odds of a person's skin off the face, of every cell; see `pvg.skin.body`.

    rgb: (h, w, 3);  person: (h, w), 255 on people;  face_mask: (h, w) in [0, 1], the face's own mask;
    against: (h, w), log-odds for what lies around the head;
    cube, ears: (n, n, n) log-odds of colours in the key frame's light at n even steps of R, G, B, everywhere and where
    the ears are;  gain: (3,) to that light;
    frame: (16,) float32 of the head: 0 chin, 2 neck, 4 middle, 6 across, 8 down (x, y each), 10 size, 11 half width,
    12 height above and 13 below the middle of what lies around it, 14 half width of its oval, 15 the ears' depth. It is
    read where it is used: naming its parts outside of the loops rounds other sums together, and changes assets.
    """
    h, w = out.shape
    none, one, half = np.float32(0.0), np.float32(1.0), np.float32(0.5)
    last = cube.shape[0] - 1
    unit = np.float32(last) / np.float32(255.0)
    size, wide, above, below = frame[10], frame[11], frame[12], frame[13]
    at, share = np.empty(3, np.int32), np.empty(3, np.float32)
    for i in range(h):
        chin_y, y = (np.float32(i) - frame[1]) / size, (np.float32(i) - frame[5]) / size
        for j in range(w):
            seen = np.float32(person[i, j]) * np.float32(1.0 / 255.0)
            if seen < weights.no_person:
                out[i, j] = -weights.most
                continue
            for k in range(3):
                place = min(np.float32(rgb[i, j, k]) * gain[k], np.float32(255.0)) * unit
                at[k] = min(int(place), last - 1)
                share[k] = place - np.float32(at[k])
            total = _of_cube(cube, at, share)
            x = (np.float32(j) - frame[4]) / size
            side, depth = abs(x * frame[6] + y * frame[7]), x * frame[8] + y * frame[9]
            p = (side - frame[14] - weights.ear_beside) / weights.ear_width
            q = (depth - frame[15]) / weights.ear_height
            at_ear = half * (p * p + q * q)
            at_ear = min(weights.ear_rise * np.exp(-at_ear), one) if at_ear < weights.ear_reach else none
            if at_ear > none:
                total += at_ear * max(_of_cube(ears, at, share) - total, none)
            total -= against[i, j] * (one - weights.ear_bare * at_ear)
            sure = total
            total += min(weights.person * (seen - half), weights.person_for)
            if total + weights.neck < none:  # whatever else is said
                out[i, j] = max(total, -weights.most)
                continue
            # green stands for the brightness whose evenness is measured
            top, bottom, left, right = max(i - 1, 0), min(i + 2, h), max(j - 1, 0), min(j + 2, w)
            mean, square, count = none, none, none
            for y_near in range(top, bottom):
                for x_near in range(left, right):
                    value = np.float32(rgb[y_near, x_near, 1])
                    mean += value
                    square += value * value
                    count += one
            mean /= count
            uneven = np.sqrt(max(square / count - mean * mean, none)) / (mean + weights.texture_dark)
            total -= weights.texture * (one - at_ear) * max(uneven - weights.texture_from, none)
            way = (np.float32(j) - frame[0]) / size * frame[2] + chin_y * frame[3]
            p, q = side / wide, depth / (above if depth < none else below)
            around = one - smoothstep(np.sqrt(p * p + q * q), weights.head_begins, weights.head_ends)
            if around > none:
                ear = at_ear * smoothstep(sure, weights.ear_begins, weights.ear_ends)
                total -= weights.head * around * (one - weights.ear_release * ear)
            if face_mask[i, j] > none:
                total += weights.neck * face_mask[i, j] * smoothstep(way, weights.neck_begins, weights.neck_ends)
            out[i, j] = min(max(total, -weights.most), weights.most)
