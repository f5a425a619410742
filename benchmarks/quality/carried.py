"""What a look carries besides the colour of the skin: tonal contrast, parts against the skin, and the place of light.

One picture of a face is described by a few numbers, the clip's before and after and the reference's alike; a pair's row
holds those of all three, and the report makes slopes, correlations and shares of all pairs together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.quality.color import delta_e_of_labs
from benchmarks.quality.faces import Bools, Image, View

PARTS = ("lips", "lids", "blush")
_LEAST_PIXELS = 40
_MOST_PIXELS = 6000
_LEAST_CHANGE = 3.0  # CIEDE2000 of the open skin below which leak is not told from noise
_SHADES = (10, 90)  # percentiles of L between which tones lie

Doubles = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Described:
    """One face in one picture, in CIELAB.

    skin: (3,) median of the open skin;  ring: (3,) median of that around the lips, if seen;  parts: lips and lids less
    skin, blush is cheeks less forehead, (3,);  tones: p90 − p10 of L of the open skin;  hues: spread of a and b there;
    light: (2,) rise of L over one width of the face, to its left-right and up-down.
    """

    skin: Doubles
    ring: Doubles | None
    parts: dict[str, Doubles]
    tones: float
    hues: float
    light: Doubles


def _labs(part: Image, where: Bools) -> Doubles:
    """(n, 3) CIELAB of at most some thousand pixels of a mask, evenly over it."""
    pixels = part[where]
    few = pixels[:: max(1, len(pixels) // _MOST_PIXELS)].astype(np.float32) / np.float32(255)
    return np.asarray(cv2.cvtColor(few[None], cv2.COLOR_RGB2Lab)[0], np.float64)


def _median(part: Image, where: Bools) -> Doubles | None:
    return np.median(_labs(part, where), axis=0) if int(where.sum()) >= _LEAST_PIXELS else None


def describe(part: Image, view: View) -> Described:
    """The face in a picture (h, w, 3) of the view's window; the view's skin must not be empty."""
    colors = _labs(part, view.skin)
    skin = np.median(colors, axis=0)
    medians = {name: _median(part, where) for name, where in view.parts.items()}
    parts = {name: medians[name] - skin for name in ("lips", "lids") if medians[name] is not None}  # type: ignore[operator]
    if medians["cheeks"] is not None and medians["forehead"] is not None:
        parts["blush"] = medians["cheeks"] - medians["forehead"]
    low, high = np.percentile(colors[:, 0], _SHADES)
    ys, xs = np.nonzero(view.skin)
    step = max(1, len(xs) // _MOST_PIXELS)
    places = np.column_stack([xs[::step], ys[::step]]) / view.width
    axes = np.column_stack([view.data.landmarks.axes.across, view.data.landmarks.axes.down])
    design = np.column_stack([np.ones(len(places)), places @ axes])
    light = np.linalg.lstsq(design, colors[: len(places), 0], rcond=None)[0][1:]
    hues = float(np.sqrt(colors[:, 1:].var(axis=0).sum()))
    return Described(skin, medians["ring"], parts, float(high - low), hues, np.asarray(light))


def carried_row(before: Described, after: Described, wanted: Described) -> dict[str, Any]:
    """What one pair adds: tones, hues and light of the three, the way of the parts, the leak around the lips."""
    out: dict[str, Any] = {
        "tones": [before.tones, after.tones, wanted.tones],
        "hues": [before.hues, after.hues, wanted.hues],
        "light": [before.light.tolist(), after.light.tolist(), wanted.light.tolist()],
    }
    for name in PARTS:
        if all(name in one.parts for one in (before, after, wanted)):
            gap = wanted.parts[name] - before.parts[name]
            gone = after.parts[name] - before.parts[name]
            out[name] = [float(gone @ gap), float(gap @ gap)]
    moved = delta_e_of_labs(before.skin, after.skin)
    if before.ring is not None and after.ring is not None and moved >= _LEAST_CHANGE:
        out["leak"] = delta_e_of_labs(before.ring, after.ring) / moved
        out["cloud"] = delta_e_of_labs(before.ring + (after.skin - before.skin), after.ring)
    return out


def _correlation(first: Doubles, second: Doubles) -> float:
    if np.ptp(first) == 0 or np.ptp(second) == 0:
        return float("nan")
    return float(np.corrcoef(first, second)[0, 1])


def slope_and_correlation(triples: list[list[float]]) -> tuple[float, float]:
    """Of the logarithms of (before, after, wanted), all pairs: the slope of after over wanted; their correlation."""
    after, wanted = (np.log(np.maximum([triple[k] for triple in triples], 0.1)) for k in (1, 2))
    slope = float(np.polyfit(wanted, after, 1)[0]) if np.ptp(wanted) > 0 else float("nan")
    return slope, _correlation(after, wanted)


def light_correlation(rows: list[list[list[float]]]) -> float:
    """Correlation of both gradients of light, after against wanted, over all pairs: the mean of the two."""
    after, wanted = (np.array([row[k] for row in rows]) for k in (1, 2))
    return float(np.mean([_correlation(after[:, axis], wanted[:, axis]) for axis in (0, 1)]))


def share_carried(ways: list[list[float]]) -> float:
    """Share of the gap between clip and reference that is gone, percent: ways are (gone · gap, gap · gap)."""
    return 100.0 * sum(way[0] for way in ways) / max(sum(way[1] for way in ways), 1e-9)
