from __future__ import annotations

from benchmarks.timing import Measured, in_turns


def test_things_are_measured_in_turns_forwards_and_backwards() -> None:
    order: list[str] = []
    taken = in_turns({"a": lambda: order.append("a"), "b": lambda: order.append("b")}, 3)
    assert order == ["a", "b", "b", "a", "a", "b"]
    assert len(taken["a"].wall.values) == len(taken["b"].cpu.values) == 3


def test_ratios_are_taken_round_by_round() -> None:
    ratio = Measured((2.0, 8.0, 3.0)).over(Measured((1.0, 2.0, 3.0)))
    assert ratio.values == (2.0, 4.0, 1.0)
    assert ratio.median == 2.0
    assert ratio.spread == 1.5
