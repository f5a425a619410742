from __future__ import annotations

import numpy as np

from benchmarks.direct import direct_membrane, held_pixels
from pvg.membrane import Lattice, build_membrane, cut_edges


def test_the_direct_solve_reproduces_linear_fields_and_agrees_with_the_membrane() -> None:
    turn = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    points = np.stack([60 + 50 * np.cos(turn), 50 + 40 * np.sin(turn)], axis=1)
    values = np.stack([points[:, 0] - points[:, 1], 20 * np.sin(3 * turn)], axis=1)
    spans = ((0, len(points), True),)
    held, known = held_pixels(points, spans, values, (121, 101))
    y, x = np.mgrid[:101, :121]
    inside = np.hypot((x - 60) / 50, (y - 50) / 40) < 1.0
    assert inside.sum() > 5000
    solved = direct_membrane(held, known, inside | known)
    # held pixels carry the value of the curve up to 0.7 px away, and the slope is one level a pixel
    assert np.abs(solved[..., 0] - (x - y))[inside].max() < 1.5
    cuts = cut_edges(points, spans, Lattice.over((0, 0, 121, 101)))
    ours = build_membrane(cuts).solve(values).crop(0, 0, 121, 101)
    assert np.abs(ours - solved)[inside].mean() < 0.15
