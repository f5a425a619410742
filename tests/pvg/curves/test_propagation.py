from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pvg.curves import BOUNDARY, CURVES, Chain, ColorTable, CurveLabels, match, table_labels


def labels_with(counts: list[int]) -> CurveLabels:
    curve = np.concatenate([np.full(n, c, np.int16) for c, n in enumerate(counts)])
    s = [np.arange(n) / (n if CURVES[c].closed else n - 1) for c, n in enumerate(counts)]
    return CurveLabels(curve, np.concatenate(s).astype(np.float32))


counts = st.lists(st.integers(4, 60), min_size=len(CURVES), max_size=len(CURVES))


def test_the_table_maps_onto_itself_without_any_change() -> None:
    colors = np.random.default_rng(0).uniform(0, 255, (len(table_labels()), 3)).astype(np.float32)
    assert match(colors, table_labels(), table_labels()) is colors


@given(counts, st.integers(2, 5))
def test_matching_is_exact_at_landmarks(target: list[int], per_segment: int) -> None:
    """Whatever the sampling of the target, a sample on a landmark gets that landmark's colour."""
    table = table_labels()
    colors = np.random.default_rng(1).uniform(0, 255, (len(table), 3)).astype(np.float32)
    for c, curve in enumerate(CURVES):  # the target has the landmarks of every landmark curve among its samples
        if curve.knots:
            target[c] = len(curve.knots) * per_segment if curve.closed else (len(curve.knots) - 1) * per_segment + 1
    labels = labels_with(target)
    matched = match(colors, table, labels)
    for c, curve in enumerate(CURVES):
        if not curve.knots:
            continue
        ours, theirs = labels.spans[c], table.spans[c]
        at_target = matched[ours[0] : ours[1] : per_segment][: len(curve.knots)]
        at_table = colors[theirs[0] : theirs[1] : curve.per_segment][: len(curve.knots)]
        np.testing.assert_allclose(at_target, at_table, atol=0.02)


@given(counts, counts)
def test_matching_keeps_a_curve_of_one_colour_and_never_overshoots(source: list[int], target: list[int]) -> None:
    one, two = labels_with(source), labels_with(target)
    rng = np.random.default_rng(2)
    flat = np.repeat(rng.uniform(0, 255, len(CURVES)), source)[:, None].astype(np.float32)
    np.testing.assert_allclose(
        match(flat, one, two)[:, 0], np.repeat(flat[np.cumsum(source) - 1, 0], target), atol=1e-3
    )
    rough = rng.uniform(0, 255, (len(one), 2)).astype(np.float32)
    matched = match(rough, one, two)
    for (a, b, _), (c, d, _) in zip(one.spans, two.spans, strict=True):
        assert (matched[c:d] >= rough[a:b].min(axis=0) - 1e-3).all()
        assert (matched[c:d] <= rough[a:b].max(axis=0) + 1e-3).all()


def test_a_closed_curve_is_interpolated_across_its_start() -> None:
    n = [4] * len(CURVES)
    source = labels_with(n)
    n[BOUNDARY] = 8
    target = labels_with(n)
    colors = np.zeros((len(source), 1), np.float32)
    start, stop, _ = source.spans[BOUNDARY]
    colors[start:stop, 0] = (10, 20, 30, 40)
    start, stop, _ = target.spans[BOUNDARY]
    assert match(colors, source, target)[start:stop, 0].tolist() == [10, 15, 20, 25, 30, 35, 40, 25]


def test_the_chain_drifts_and_the_table_does_not() -> None:
    """Why the table is the default: resampling frame after frame smooths the colours away."""
    rng = np.random.default_rng(3)
    table = table_labels()
    colors = rng.uniform(0, 255, (len(table), 1)).astype(np.float32)
    chain, by_table = Chain(colors, table), ColorTable(colors, table)
    drift = []
    for frame in range(120):
        labels = labels_with([int(n) for n in rng.integers(30, 60, len(CURVES))])
        chained = chain.step(labels)
        if frame in (0, 119):
            drift.append(float(np.abs(chained - by_table.at(labels)).mean()))
    assert drift[0] == 0.0
    assert drift[1] > 10.0


def test_chain_between_equal_samplings_is_exact() -> None:
    colors = np.random.default_rng(4).uniform(0, 255, (len(table_labels()), 6)).astype(np.float32)
    chain = Chain(colors, table_labels())
    for _ in range(300):
        out = chain.step(table_labels())
    np.testing.assert_array_equal(out, colors)


def test_a_table_gives_any_frame_at_any_time_what_matching_to_the_key_frame_does() -> None:
    rng = np.random.default_rng(5)
    colors = rng.uniform(0, 255, (len(table_labels()), 3)).astype(np.float32)
    by_table = ColorTable(colors, table_labels())
    one, two = (labels_with([int(n) for n in rng.integers(10, 60, len(CURVES))]) for _ in range(2))
    for labels in (one, two, one):
        np.testing.assert_array_equal(by_table.at(labels), match(colors, table_labels(), labels))
    assert by_table.at(table_labels()) is colors


def test_different_sets_of_curves_cannot_be_matched() -> None:
    class TwoCurves:
        s = np.array([0.0, 1.0, 0.0, 1.0], np.float32)
        spans = ((0, 2, False), (2, 4, False))

    with pytest.raises(ValueError, match="cannot match"):
        match(np.zeros((len(table_labels()), 3), np.float32), table_labels(), TwoCurves())
