"""The membrane of an 800x1096 face on one thread: time of its parts and error against the direct solve."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

import pvg
from benchmarks.timing import Measured, in_turns, seconds
from pvg._arrays import Bools, Doubles
from pvg.curves.labels import BOUNDARY, table_labels
from pvg.membrane import Lattice, build_membrane, cut_edges
from pvg.rendering.placed_face import open_region

FACE = (800, 1096)  # of the skin mask, its box with hair and margins is larger
LARGEST_CORRECTION = 70.0  # levels of 255


@dataclass(frozen=True, eq=False)
class Face:
    """positions: (S, 2) curve samples in a box of `size` (width, height);  correction: (S, 3) at them."""

    positions: Doubles
    correction: Doubles
    size: tuple[int, int]


def scaled_face(portrait: str, asset: str, reference: str) -> Face:
    """A portrait's face stretched until its mask is `FACE` in size, in its box, with a real correction."""
    with pvg.open_asset(asset, portrait) as face, pvg.open_asset(reference) as colors:
        key = face.records[0].key_frames[0]
        data = face.face_frame(0, key.frame)
        assert data is not None
        region = open_region(data, table_labels(), face.media.width, face.media.height)
        assert region is not None
        correction = pvg.transfer(face, colors).colors[0][0].astype(np.float64) - key.colors
        start, stop, _ = table_labels().spans[BOUNDARY]
        stretch = np.asarray(FACE) / np.ptp(region.positions[start:stop].astype(np.float64), axis=0)
        low, high = data.box[:2].astype(np.float64), data.box[2:]
        width, height = (round(float(v)) for v in (high - low) * stretch)
        positions = (region.positions - low) * stretch
        return Face(positions, correction * (LARGEST_CORRECTION / np.abs(correction).max()), (width, height))


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


def within_boundary(points: Doubles, size: tuple[int, int]) -> Bools:
    """(h, w): the pixels inside the mask boundary's polygon."""
    start, stop, _ = table_labels().spans[BOUNDARY]
    filled = np.zeros((size[1], size[0]), np.uint8)
    cv2.fillPoly(filled, [np.rint(points[start:stop] * 16).astype(np.int32)], (1,), shift=4)
    return filled.astype(np.bool_)


def membrane_times(faces: list[tuple[str, str, str]], rounds: int) -> dict[str, Any]:
    """CPU milliseconds of the parts of one membrane (three channels), and the errors of all, in levels of 255.

    faces: (portrait, its asset, reference's asset); times are those of the first.
    """
    face = scaled_face(*faces[0])
    points, values, size = face.positions, face.correction, face.size
    spans, lattice = table_labels().spans, Lattice.over((0, 0, *size))
    cuts = cut_edges(points, spans, lattice)
    operator = build_membrane(cuts)
    solved = operator.solve(values)
    taken = in_turns(
        {
            "curves onto the lattice": lambda: cut_edges(points, spans, lattice),
            "equations": lambda: build_membrane(cuts),
            "solve": lambda: operator.solve(values),
            "read at full size": lambda: solved.crop(0, 0, *size),
            "in all": lambda: build_membrane(cut_edges(points, spans, lattice)).solve(values),
        },
        rounds,
    )
    each = {Path(portrait).stem: errors(scaled_face(portrait, *assets)) for portrait, *assets in faces}
    return {
        "ms": {name: one.cpu.scaled(1000.0).to_json() for name, one in taken.items()},
        "errors": {
            name: Measured(tuple(one[name] for one in each.values())).to_json() for name in ("mean", "p99", "max")
        },
        "each": each,
        "box": list(size),
        "nodes": [lattice.width, lattice.height],
    }


def errors(face: Face) -> dict[str, float]:
    """Mean, 99th percentile and largest error inside the mask's boundary, and the direct solve's CPU time."""
    spans, size = table_labels().spans, face.size
    held, known = held_pixels(face.positions, spans, face.correction, size)
    inside = within_boundary(face.positions, size)
    direct: list[Doubles] = []
    _, direct_s = seconds(lambda: direct.append(direct_membrane(held, known, inside | known)))
    operator = build_membrane(cut_edges(face.positions, spans, Lattice.over((0, 0, *size))))
    error = np.abs(operator.solve(face.correction).crop(0, 0, *size) - direct[0])[inside]
    return {
        "mean": float(error.mean()),
        "p99": float(np.percentile(error, 99)),
        "max": float(error.max()),
        "unknowns": int((inside & ~known).sum()),
        "direct_ms": direct_s * 1000.0,
    }
