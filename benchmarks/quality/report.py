"""The report: Markdown, JSON, plots and contact sheets out of the measured results."""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.quality.carried import PARTS, light_correlation, share_carried, slope_and_correlation
from benchmarks.quality.clips import COLOR_FRAMES, COSTLY_FRAMES, MOTION_PAIRS, strip_columns
from benchmarks.quality.color import TONE_GROUPS, tone_group
from benchmarks.quality.peers import (
    AT_LAMBDA_ONE,
    DEEP,
    FULL,
    MK,
    OURS,
    PAPER,
    PAPER_MASK,
    full_options,
    has_option,
    method_names,
)
from benchmarks.quality.plots import draw_plots
from benchmarks.quality.regions import regions_table
from benchmarks.quality.sheets import save_sheet

HEADLINE = OURS[0]
_WORST = 3
Results = dict[str, Any]
Value = Callable[[Results, str], float | None]


def _mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None and math.isfinite(value)]
    return float(np.mean(known)) if known else None


def _cases(results: Results, method: str) -> list[dict[str, Any]]:
    return [case for clip in results["clips"] for case in clip["cases"] if case["method"] == method]


def _colors(results: Results, method: str) -> list[dict[str, Any]]:
    return [row for clip in results["clips"] for row in clip["colors"] if row["method"] == method]


def _case_mean(name: str) -> Value:
    return lambda results, method: _mean(case[name] for case in _cases(results, method))


def _case_worst(name: str) -> Value:
    return lambda results, method: max((c[name] for c in _cases(results, method) if c[name] is not None), default=None)


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if len(values) else None


def _case_median(name: str) -> Value:
    return lambda results, method: _median([c[name] for c in _cases(results, method) if c[name] is not None])


def _closer(rows: list[dict[str, Any]], suffix: str = "") -> float | None:
    """Share of the colour distance that is gone, in percent, over all pairs together."""
    before = sum(row["distance_before" + suffix] for row in rows)
    return 100.0 * (1.0 - sum(row["distance" + suffix] for row in rows) / before) if before else None


def _percentile(rows: list[dict[str, Any]], name: str, share: float) -> float | None:
    return float(np.percentile([row[name] for row in rows], share)) if rows else None


def _leak(results: Results, method: str) -> float | None:
    return max((row["leak"] for row in results["leak"] if row["method"] == method), default=None)


def _truth(way: str) -> Value:
    """Mean over all clips' frames of |H(g) − H(ĝ)|, for ours by the table and the paper's by its chain with resets."""

    def value(results: Results, method: str) -> float | None:
        column = "table" if method in OURS else "chain, reset" if method == PAPER else None
        rows = [row[column] for clip in results["truth"] for row in clip["rows"]] if column else []
        return _mean(rows) if way == "mean" else max(rows, default=None)

    return value


def _ramp(key: str) -> Value:
    def value(results: Results, method: str) -> float | None:
        rows = [row for row in results["ramp"] if row["method"] == method]
        worst = [max(row[key]) if isinstance(row[key], list) else row[key] for row in rows]
        return max(worst, default=None)

    return value


def _carried(name: str, reduce: Callable[[list[Any]], float]) -> Value:
    """A number of all pairs together. Light and parts are asked of full strength, where the library has that."""

    def value(results: Results, method: str) -> float | None:
        wanted = FULL if method == HEADLINE and name in FULL_MEASURES and _colors(results, FULL) else method
        rows = [row[name] for row in _colors(results, wanted) if name in row]
        return reduce(rows) if len(rows) > 1 else None

    return value


def _region(*names: str, median: bool = False) -> Value:
    def value(results: Results, method: str) -> float | None:
        rows = [row for row in results["regions"] if row["method"] == method]
        found = [row[name] for row in rows for name in names if row.get(name) is not None]
        return _median(found) if median else _mean(found)

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


_ONE_PERSON = tuple(f"ΔE {name}" for name in ("neck", "ear", "hand"))


def _middle(values: list[float]) -> float:
    return float(np.median(values))


def _high(values: list[float]) -> float:
    return float(np.percentile(values, 90))


FULL_MEASURES = (*PARTS, "leak", "cloud", "light")


def _steady(title: str, name: str, target: float | None = None) -> Measure:
    return Measure(f"steadiness, {title}, dB", _case_mean(name), 4, target)


MEASURES = (
    Measure("closer: sliced Wasserstein of open skin, %", lambda r, m: _closer(_colors(r, m)), 1, 75.0, at_least=True),
    Measure("colour: ΔE2000, median", lambda r, m: _percentile(_colors(r, m), "delta_e", 50), 2, 1.3),
    Measure("colour: ΔE2000, 90th percentile", lambda r, m: _percentile(_colors(r, m), "delta_e", 90), 2, 4.5),
    Measure("tonal contrast, slope", _carried("tones", lambda v: slope_and_correlation(v)[0]), 2, 0.8, at_least=True),
    Measure(
        "tonal contrast, correlation", _carried("tones", lambda v: slope_and_correlation(v)[1]), 2, 0.9, at_least=True
    ),
    Measure("spread of hue and chroma, slope", _carried("hues", lambda v: slope_and_correlation(v)[0]), 2),
    Measure("parts: lips carried, %", _carried("lips", share_carried), 0, 60.0, at_least=True),
    Measure("parts: lids carried, %", _carried("lids", share_carried), 0, 50.0, at_least=True),
    Measure("parts: blush carried, %", _carried("blush", share_carried), 0, 40.0, at_least=True),
    Measure("leak around the lips, change over that of open skin, median", _carried("leak", _middle), 2, 1.0),
    Measure("the same: ΔE2000 between the two changes, 90th percentile", _carried("cloud", _high), 2),
    Measure("place of light, correlation", _carried("light", light_correlation), 2, 0.6, at_least=True),
    Measure("one person: ΔE2000 of neck, ears, hands, median", _region(*_ONE_PERSON, median=True), 2, 2.0),
    Measure("body's ΔE2000, median", _region("ΔE body", median=True), 2),
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


def _number(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
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
            text = _number(value, measure.digits)
            if value is not None and (met := measure.met(value, name)) is not None:
                text += " met" if met else " **missed**"
            cells.append(text)
        rows.append([measure.name, measure.wanted, *cells])
    return _table(["measure", "target", *names], rows)


def _groups(results: Results, of_clip: bool) -> str:
    """Measures of the headline method by skin-tone group of the clip or the reference."""
    tones = {clip["clip"]: clip["ita"] for clip in results["clips"]}

    def group(row: dict[str, Any]) -> str:
        return tone_group(tones[row["clip"]] if of_clip else row["reference_ita"])

    rows = []
    for name in TONE_GROUPS:
        cases = [case for case in _cases(results, HEADLINE) if group(case) == name]
        colors = [row for row in _colors(results, HEADLINE) if group(row) == name]
        if not colors:
            continue
        others = [[r for r in _colors(results, m) if group(r) == name] for m in (PAPER, MK)]
        rows.append(
            [
                name,
                str(len(colors)),
                _number(_mean(c["steady_face"] for c in cases), 4),
                _number(_median([c["warping_face"] for c in cases if c["warping_face"] is not None]), 3),
                _number(_mean(c["detail"] for c in cases), 4),
                _number(_closer(colors), 1),
                *(_number(_percentile(colors, "delta_e", share), 2) for share in (50, 90)),
                *(_number(_percentile(part, "delta_e", 50), 2) for part in others),
            ]
        )
    head = ["group", "pairs", "steadiness, face", "warping, face", "detail", "closer, %", "ΔE median", "ΔE p90"]
    return _table([*head, "ΔE median, paper's", "ΔE median, masked MK"], rows)


_CASE_COLUMNS = (
    ("steady_whole", "steady, whole", 4),
    ("steady_face", "steady, face", 4),
    ("raw_whole", "raw, whole", 4),
    ("raw_face", "raw, face", 4),
    ("warping_whole", "warping, whole", 3),
    ("warping_face", "warping, face", 3),
    ("warping_inner", "warping, inner", 3),
    ("detail", "detail", 4),
)


def _case_table(results: Results, method: str) -> str:
    rows = [
        [case["clip"], case["reference"], *(_number(case.get(key), digits) for key, _, digits in _CASE_COLUMNS)]
        for case in _cases(results, method)
    ]
    return _table(["clip", "reference", *(title for _, title, _ in _CASE_COLUMNS)], rows)


# measure -> (key, whether its rows are the colours of all portraits, whether more is worse)
_RANKED = {
    "steadiness-face": ("steady_face", False, True),
    "warping": ("warping_face", False, True),
    "detail": ("detail", False, False),
    "delta-e": ("delta_e", True, True),
}


def worst_cases(results: Results) -> dict[str, list[dict[str, Any]]]:
    """The worst cases of the headline method by each main measure, one a clip so that one clip does not fill them."""
    out: dict[str, list[dict[str, Any]]] = {}
    for title, (key, colors, more) in _RANKED.items():
        rows = _colors(results, HEADLINE) if colors else _cases(results, HEADLINE)
        ranked = sorted((row for row in rows if row[key] is not None), key=itemgetter(key), reverse=more)
        chosen: dict[str, dict[str, Any]] = {}
        for row in ranked:
            chosen.setdefault(row["clip"], row)
        out[title] = list(chosen.values())[:_WORST]
    return out


def _write_sheets(results: Results, out: Path) -> list[str]:
    lines = []
    for title, rows in worst_cases(results).items():
        key = _RANKED[title][0]
        strips, names = [], []
        for row in rows:
            caption = f"{row['clip']} with {row['reference']}: {key} {row[key]:.4g}"
            strips.append((caption, out / "strips" / f"{row['clip']}--{row['reference']}.jpg"))
            names.append(f"    {caption}")
        save_sheet(out / f"worst-{title}.jpg", strips, strip_columns())
        lines += [f"- by {title} ([sheet](worst-{title}.jpg)):", *(f"  - {name.strip()}" for name in names)]
    return lines


def _truths(results: Results) -> str:
    rows = []
    for clip in results["truth"]:
        ways = [key for key in clip["rows"][0] if key != "frame"] if clip["rows"] else []
        for way in ways:
            values = [row[way] for row in clip["rows"]]
            rows.append([clip["clip"], way, _number(_mean(values), 2), *(_number(value, 1) for value in values)])
    width = max((len(row) for row in rows), default=3)
    head = ["clip", "way", "mean", *(f"{100 * k / max(1, width - 4):.0f} %" for k in range(width - 3))]
    return _table(head, [row + ["–"] * (width - len(row)) for row in rows])


def _ramps(results: Results) -> str:
    rows = []
    for row in results["ramp"]:
        deltas = row["delta_e"]
        shown = [deltas[0], deltas[len(deltas) // 2], deltas[-1], max(deltas)]
        direction = "up" if row["up"] else "down"
        rows.append(
            [
                *(row["clip"], direction, row["reference"], row["method"]),
                *(_number(value, 1) for value in (100 * row["white"], *shown)),
                *(_number(row[key], 2) for key in ("step", "step_in")),
            ]
        )
    head = ["clip", "gain", "reference", "method", "at white, %", "ΔE first", "middle", "last", "worst"]
    return _table([*head, "largest step", "the input's"], rows)


def _regions(results: Results) -> str:
    rows = [row for row in results["regions"] if row["method"] == HEADLINE]
    if not rows:
        return "Not measured: no labelled regions of these files."
    left_out = [line for line in results["regions_left_out"] if ", " not in line or line.count(HEADLINE)]
    return "\n".join([regions_table(rows), *(f"- left out: {line}" for line in left_out)])


def _leaks(results: Results) -> str:
    rows = [[row["scene"], row["reference"] or "–", row["method"], _number(row["leak"], 3)] for row in results["leak"]]
    return _table(["scene", "reference", "method", "std of the face's mean, levels"], rows)


def _masks(results: Results) -> str:
    if not results["masks"]:
        return "Not measured: there are no labelled portraits here."
    keys = [key for key in results["masks"][0] if key != "portrait"]
    rows = [[row["portrait"], *(_number(row[key], 3) for key in keys)] for row in results["masks"]]
    return _table(["portrait", *keys], rows)


def _notes(results: Results) -> list[str]:
    about = results["about"]
    extent = "whole clips" if about["frames"] is None else f"their first {about['frames']} frames with a face"
    options = ", ".join(f"{name} = {value:g}" for name, value in full_options().items())
    lines = [
        f"{len(results['clips'])} clips from {about['source']}, {extent}, each with two of "
        f"{', '.join(about['references'])}; colours in {COLOR_FRAMES} frames of each with all "
        f"{len(about['portraits'])} portraits. {about['seconds']} s on this machine ({platform.machine()}), "
        f"{about['processor_s']} s of processor time.",
        "Frames are drawn and compared without encoding.",
        f"Warping errors are of {MOTION_PAIRS} pairs of neighbouring frames spread over each clip. Being slow, raster "
        f"transport, histograms and 12 bits are drawn on {COSTLY_FRAMES} consecutive frames with one reference, and "
        "their colours measured in one frame.",
        f"The last column, {DEEP}: on the same frames held in 12 bits; it tells what rounding to 8 costs.",
        f"Light and parts in the first column are with {options}."
        if options
        else "Light and parts are those of the defaults: the library has no options for them.",
        f"The rest of the skin: {'the default extent' if has_option('extent') else 'the library draws faces alone'}.",
    ]
    if about["unusable_portraits"]:
        lines.append(f"Portraits without a usable face: {', '.join(about['unusable_portraits'])}.")
    absent = [clip["clip"] for clip in results["clips"] if not clip["paper"]]
    if absent:
        lines.append(f"The paper's way lost the face, and has no figures, on: {', '.join(absent)}.")
    lines += [
        f"Not installed, so not measured: {name} ({package})." for name, package in about["not_installed"].items()
    ]
    return lines


def write_report(results: Results, out: Path) -> str:
    """Write report.md, report.json, plots and sheets into `out`; returns the summary."""
    table = summary_table(results)
    plots = draw_plots(results, out)
    parts = [
        "# Quality",
        "\n".join(f"- {line}" for line in _notes(results)),
        "## Summary",
        table,
        "## By skin tone of the clip (" + HEADLINE + ")",
        _groups(results, of_clip=True),
        "## By skin tone of the reference (" + HEADLINE + ")",
        _groups(results, of_clip=False),
        f"## Worst cases ({HEADLINE}, one a clip)",
        "\n".join(_write_sheets(results, out)),
        f"## Labelled regions ({HEADLINE}), percent of pixels that change with the face",
        _regions(results),
        "## Exposure ramps",
        _ramps(results),
        "## Truth of the boundary colours, levels",
        _truths(results),
        "## Leak",
        _leaks(results),
        "## Masks, IoU with the labels",
        _masks(results),
        *(f"![{name}]({name})" for name in plots),
        *(text for name in OURS for text in (f"## Clip and reference: {name}", _case_table(results, name))),
    ]
    if not plots:
        parts.append("No plots: matplotlib is not installed (`make bench-quality` installs it).")
    (out / "report.md").write_text("\n\n".join(parts) + "\n")
    summary = {
        measure.name: {name: measure.value(results, name) for name in method_names()} | {"target": measure.target}
        for measure in MEASURES
    }
    (out / "report.json").write_text(json.dumps({"summary": summary, **results}, indent=1))
    return f"{table}\n\n{out / 'report.md'}"
