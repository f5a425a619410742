"""The rows of the summary: each measure's value for a method, its target, and whether it is met."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.quality.carried import PARTS, light_correlation, share_carried, slope_and_correlation
from benchmarks.quality.peers import AT_LAMBDA_ONE, DEEP, FULL, OURS, PAPER, PAPER_MASK, method_names

HEADLINE = OURS[0]
Results = dict[str, Any]
Value = Callable[[Results, str], float | None]


def mean(values: Iterable[float | None]) -> float | None:
    """The mean of the finite ones."""
    known = [value for value in values if value is not None and math.isfinite(value)]
    return float(np.mean(known)) if known else None


def case_rows(results: Results, method: str) -> list[dict[str, Any]]:
    """The measures over time of a method: a row a clip and reference."""
    return [case for clip in results["clips"] for case in clip["cases"] if case["method"] == method]


def color_rows(results: Results, method: str) -> list[dict[str, Any]]:
    """The colour measures of a method: a row a clip, frame and portrait."""
    return [row for clip in results["clips"] for row in clip["colors"] if row["method"] == method]


def _case_mean(name: str) -> Value:
    return lambda results, method: mean(case[name] for case in case_rows(results, method))


def _case_worst(name: str) -> Value:
    return lambda results, method: max(
        (c[name] for c in case_rows(results, method) if c[name] is not None), default=None
    )


def median(values: Sequence[float]) -> float | None:
    """The median; None of nothing."""
    return float(np.median(values)) if len(values) else None


def _case_median(name: str) -> Value:
    return lambda results, method: median([c[name] for c in case_rows(results, method) if c[name] is not None])


def closer(rows: list[dict[str, Any]], suffix: str = "") -> float | None:
    """Share of the colour distance that is gone, in percent, over all pairs together."""
    before = sum(row["distance_before" + suffix] for row in rows)
    return 100.0 * (1.0 - sum(row["distance" + suffix] for row in rows) / before) if before else None


def percentile(rows: list[dict[str, Any]], name: str, share: float) -> float | None:
    """A percentile of one column of rows; None of nothing."""
    return float(np.percentile([row[name] for row in rows], share)) if rows else None


def _leak(results: Results, method: str) -> float | None:
    return max((row["leak"] for row in results["leak"] if row["method"] == method), default=None)


def _truth(way: str) -> Value:
    """Mean over all clips' frames of |H(g) − H(ĝ)|, for ours by the table and the paper's by its chain with resets."""

    def value(results: Results, method: str) -> float | None:
        column = "table" if method in OURS else "chain, reset" if method == PAPER else None
        rows = [row[column] for clip in results["truth"] for row in clip["rows"]] if column else []
        return mean(rows) if way == "mean" else max(rows, default=None)

    return value


def _ramp(key: str) -> Value:
    def value(results: Results, method: str) -> float | None:
        rows = [row for row in results["ramp"] if row["method"] == method]
        worst = [max(row[key]) if isinstance(row[key], list) else row[key] for row in rows]
        return max(worst, default=None)

    return value


def _carried(name: str, reduce: Callable[[list[Any]], float], at_least: int = 1, *, shaven: bool = False) -> Value:
    """A number of all pairs together, of so many references at least; shaven: of those without a beard.

    Light and parts are asked of full strength, where the library has that.
    """

    def value(results: Results, method: str) -> float | None:
        wanted = FULL if method == HEADLINE and name in FULL_MEASURES and color_rows(results, FULL) else method
        of_method = [row for row in color_rows(results, wanted) if name in row]
        if shaven:
            of_method = [row for row in of_method if not row["reference_bearded"]]
        if not of_method or len({row["reference"] for row in of_method}) < at_least:
            return None
        found = reduce([row[name] for row in of_method])
        return found if math.isfinite(found) else None

    return value


def _region(*names: str, reduce: Callable[[list[float]], float | None] = mean) -> Value:
    def value(results: Results, method: str) -> float | None:
        rows = [row for row in results["regions"] if row["method"] == method]
        found = [row[name] for row in rows for name in names if row.get(name) is not None]
        return reduce(found)

    return value


def _mask(kind: Callable[[list[float]], float]) -> Value:
    def value(results: Results, method: str) -> float | None:
        column = "landmarks" if method in OURS else "ycbcr" if method == PAPER_MASK else None
        found = [row[column] for row in results["masks"]] if column else []
        return kind(found) if found else None

    return value


@dataclass(frozen=True)
class Measure:
    """A row of the summary: its value for a method, how it is written, the target with its direction, whether the
    12-bit column has it, and whether the target is asked of lambda = 1 only."""

    name: str
    value: Value
    digits: int
    target: float | None = None
    at_least: bool = False
    deep: bool = False
    at_lambda_one: bool = False

    def met(self, value: float, method: str) -> bool | None:
        """Whether the target is met; None without one for the method."""
        if self.target is None or method not in (AT_LAMBDA_ONE if self.at_lambda_one else OURS):
            return None
        return value >= self.target if self.at_least else value <= self.target

    @property
    def wanted(self) -> str:
        """The target in words."""
        if self.target is None:
            return ""
        return f"{'≥' if self.at_least else '≤'} {self.target:g}{' at λ = 1' if self.at_lambda_one else ''}"


_LINE = 6  # references that slopes and correlations need
_ONE_PERSON = tuple(f"ΔE {name}" for name in ("neck", "ear", "hand"))


def _middle(values: list[float]) -> float:
    return float(np.median(values))


def _high(values: list[float]) -> float:
    return float(np.percentile(values, 90))


FULL_MEASURES = (*PARTS, "leak", "cloud", "light")


def _line(name: str, which: int) -> Value:
    """The slope (0) or the correlation (1) of result over reference."""
    return _carried(name, lambda rows: slope_and_correlation(rows)[which], _LINE)


def _steady(title: str, name: str, target: float | None = None) -> Measure:
    return Measure(f"steadiness, {title}, dB", _case_mean(name), 4, target)


MEASURES = (
    Measure("closer: sliced Wasserstein of skin, %", lambda r, m: closer(color_rows(r, m)), 1, 75.0, at_least=True),
    Measure("colour: ΔE2000, median", lambda r, m: percentile(color_rows(r, m), "delta_e", 50), 2, 1.3),
    Measure("colour: ΔE2000, 90th percentile", lambda r, m: percentile(color_rows(r, m), "delta_e", 90), 2, 4.5),
    Measure("tonal contrast, slope", _line("tones", 0), 2, 0.8, at_least=True),
    Measure(
        "tonal contrast, correlation",
        _line("tones", 1),
        2,
        0.9,
        at_least=True,
    ),
    Measure("spread of hue and chroma, slope", _line("hues", 0), 2),
    Measure("parts: lips carried, %", _carried("lips", share_carried), 0, 60.0, at_least=True),
    Measure("lips carried, of references without a beard, %", _carried("lips", share_carried, shaven=True), 0),
    Measure("parts: lids carried, %", _carried("lids", share_carried), 0, 50.0, at_least=True),
    Measure("parts: blush carried, %", _carried("blush", share_carried), 0, 40.0, at_least=True),
    Measure("leak around the lips, change over that of open skin, median", _carried("leak", _middle), 2, 1.0),
    Measure("the same: ΔE2000 between the two changes, 90th percentile", _carried("cloud", _high), 2),
    Measure("place of light, correlation", _carried("light", light_correlation, _LINE), 2, 0.6, at_least=True),
    Measure("one person: ΔE2000 of neck, ears, hands, median", _region(*_ONE_PERSON, reduce=median), 2, 2.0),
    Measure("body's ΔE2000, median", _region("ΔE body", reduce=median), 2),
    _steady("whole frame, less its mean over 1 s", "steady_whole", 0.02),
    _steady("face, less its mean over 1 s", "steady_face", 0.02),
    _steady("whole frame, raw", "raw_whole"),
    _steady("face, raw", "raw_face"),
    Measure("steadiness, face, worst case, dB", _case_worst("steady_face"), 3),
    Measure("warping error, whole frame, median case", _case_median("warping_whole"), 3, 1.01, deep=True),
    Measure("warping error, face and edge, median case", _case_median("warping_face"), 3, 1.05, deep=True),
    Measure("warping error, well inside the matte, median case", _case_median("warping_inner"), 3, deep=True),
    Measure("exposure ramp: skin at white, worst", _ramp("white"), 3, 0.02),
    Measure("exposure ramp: ΔE2000, worst frame", _ramp("delta_e"), 1, 5.0),
    Measure("exposure ramp: largest step, levels a frame", _ramp("step"), 2, 1.5),
    Measure("exposure ramp: largest step of the input", _ramp("step_in"), 2),
    Measure("truth of g, mean, levels", _truth("mean"), 2, 3.0),
    Measure("truth of g, worst frame, levels", _truth("worst"), 2),
    Measure("leak of a growing bright panel, worst, levels", _leak, 3, 0.2),
    Measure("glow, change 2–10 px outside labelled skin over inside", _region("glow"), 3, 0.02),
    Measure("the same where nothing is labelled: walls", _region("glow on the wall"), 3),
    Measure(
        "detail, correlation of Laplacians",
        _case_mean("detail"),
        4,
        0.98,
        at_least=True,
        deep=True,
        at_lambda_one=True,
    ),
    Measure("mask IoU, mean", _mask(lambda v: float(np.mean(v))), 3, 0.965, at_least=True),
    Measure("mask IoU, worst", _mask(min), 3, 0.945, at_least=True),
)


def number(value: float | None, digits: int) -> str:
    """A number, or a dash for none."""
    return "–" if value is None else f"{value:.{digits}f}"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def summary_table(results: Results) -> str:
    """Measures against methods; ours are marked met or missed where there is a target."""
    names = method_names()
    rows = []
    for measure in MEASURES:
        cells = []
        for name in names:
            value = measure.value(results, name) if name != DEEP or measure.deep else None
            text = number(value, measure.digits)
            if value is not None and (met := measure.met(value, name)) is not None:
                text += " met" if met else " **missed**"
            cells.append(text)
        rows.append([measure.name, measure.wanted, *cells])
    return table(["measure", "target", *names], rows)
