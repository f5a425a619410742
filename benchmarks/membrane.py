"""The membrane of an 800x1096 face on one thread: time of its parts and error against the direct solve."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import pvg
from benchmarks.direct import direct_membrane, held_pixels
from benchmarks.timing import Measured, in_turns, seconds
from pvg._arrays import Bools, Doubles
from pvg.curves import BOUNDARY, table_labels
from pvg.membrane import Lattice, build_membrane, cut_edges
from pvg.rendering.placed_face import place_face

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
        data = face.face_at(0, key.frame)
        assert data is not None
        placed = place_face(data, table_labels(), face.media.width, face.media.height)
        assert placed is not None
        correction = pvg.transfer(face, colors).colors[0][0].astype(np.float64) - key.colors
        start, stop, _ = table_labels().spans[BOUNDARY]
        stretch = np.asarray(FACE) / np.ptp(placed.positions[start:stop].astype(np.float64), axis=0)
        box = data.matte.raster.box
        low, high = box[:2].astype(np.float64), box[2:]
        width, height = (round(float(v)) for v in (high - low) * stretch)
        positions = (placed.positions - low) * stretch
        return Face(positions, correction * (LARGEST_CORRECTION / np.abs(correction).max()), (width, height))


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
