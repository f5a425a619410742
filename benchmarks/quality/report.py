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

from benchmarks.quality.clips import strip_columns
from benchmarks.quality.color import TONE_GROUPS, tone_group
from benchmarks.quality.peers import AT_LAMBDA_ONE, DEEP, OURS, PAPER, method_names
from benchmarks.quality.plots import draw_plots
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


def _own_colors(results: Results, method: str) -> float | None:
    if method not in OURS:
        return None
    return max((row["own colours"] for clip in results["reconstruction"] for row in clip["rows"]), default=None)


def _mask(kind: Callable[[list[float]], float]) -> Value:
    def value(results: Results, method: str) -> float | None:
        column = "landmarks" if method in OURS else "ycbcr" if method == PAPER else None
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


MEASURES = (
    Measure("steadiness, whole frame, std of PSNR, dB", _case_mean("steady_whole"), 4, 0.0656),
    Measure("steadiness, face, std of PSNR, dB", _case_mean("steady_face"), 4, 0.03),
    Measure("steadiness, whole frame, median case, dB", _case_median("steady_whole"), 4),
    Measure("steadiness, face, median case, dB", _case_median("steady_face"), 4),
    Measure("steadiness, face, worst case, dB", _case_worst("steady_face"), 3),
    Measure("steadiness, PSNR(in, next in) - PSNR(out, next out), dB", _case_mean("step_gap"), 2),
    Measure(
        "warping error, output / input, whole frame, median case", _case_median("warping_whole"), 3, 1.02, deep=True
    ),
    Measure("the same over the face and its edge", _case_median("warping_face"), 3, deep=True),
    Measure("the same well inside the matte", _case_median("warping_inner"), 3, deep=True),
    Measure("warping error over the face, output - input, squared levels", _case_mean("warp_excess"), 2, deep=True),
    Measure("the input's own warping error over the face, squared levels, median case", _case_median("warp_input"), 2),
    Measure("reconstruction, own colours to frame 600, levels", _own_colors, 3, 0.5),
    Measure("leak of a growing bright panel, worst, levels", _leak, 3, 0.2),
    Measure("colour: closer to the reference, %", lambda r, m: _closer(_colors(r, m)), 1, 85.0, at_least=True),
    Measure("colour: ΔE2000, median", lambda r, m: _percentile(_colors(r, m), "delta_e", 50), 2, 2.5),
    Measure("colour: ΔE2000, 90th percentile", lambda r, m: _percentile(_colors(r, m), "delta_e", 90), 2, 6.0),
    Measure("colour above the nose's base: closer, %", lambda r, m: _closer(_colors(r, m), "_upper"), 1),
    Measure("the same: ΔE2000, median", lambda r, m: _percentile(_colors(r, m), "delta_e_upper", 50), 2),
    Measure("the same: ΔE2000, 90th percentile", lambda r, m: _percentile(_colors(r, m), "delta_e_upper", 90), 2),
    Measure(
        "detail kept, correlation of Laplacians",
        _case_mean("detail"),
        4,
        0.99,
        at_least=True,
        deep=True,
        at_lambda_one=True,
    ),
    Measure("mask IoU, mean", _mask(lambda v: float(np.mean(v))), 3, 0.95, at_least=True),
    Measure("mask IoU, worst", _mask(min), 3, 0.90, at_least=True),
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
        others = [[r for r in _colors(results, m) if group(r) == name] for m in (PAPER, _LINEAR)]
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
    return _table([*head, "ΔE median, paper's", "ΔE median, masked linear"], rows)


_LINEAR = "masked linear, frame 1"
_CASE_COLUMNS = (
    ("steady_whole", "steady, whole", 4),
    ("steady_face", "steady, face", 4),
    ("step_gap", "PSNR step gap", 2),
    ("warping_whole", "warping, whole", 3),
    ("warping_face", "warping, face", 3),
    ("warping_inner", "warping, inner", 3),
    ("detail", "detail", 4),
    ("distance_before", "SW before", 1),
    ("distance", "SW after", 1),
    ("delta_e_before", "ΔE before", 1),
    ("delta_e", "ΔE", 2),
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
        key, colors, _ = _RANKED[title]
        strips, names = [], []
        for row in rows:
            caption = f"{row['clip']} with {row['reference']}: {key} {row[key]:.4g}"
            strips.append((caption, out / "strips" / f"{row['clip']}--{row['reference']}{'--color' * colors}.jpg"))
            names.append(f"    {caption}")
        save_sheet(out / f"worst-{title}.jpg", strips, strip_columns())
        lines += [f"- by {title} ([sheet](worst-{title}.jpg)):", *(f"  - {name.strip()}" for name in names)]
    return lines


def _reconstruction(results: Results) -> str:
    parts = []
    for clip in results["reconstruction"]:
        keys = [key for key in clip["rows"][0] if key != "frame"]
        rows = [[f"{row['frame']:.0f}", *(_number(row[key], 3) for key in keys)] for row in clip["rows"]]
        parts.append(
            f"{clip['clip']}, {clip['distinct_frames']} frames there and back\n\n" + _table(["frame", *keys], rows)
        )
    return "\n\n".join(parts)


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
    lines = [
        f"{len(results['clips'])} clips from {about['source']}, the first {about['frames']} frames with a face; "
        f"over time with {', '.join(about['references'])}; colours in the first such frame, with all "
        f"{len(about['portraits'])} portraits. {about['seconds']} s on this machine ({platform.machine()}).",
        "Frames are drawn and compared without encoding.",
        "Being slow, the peers but the masked linear one are drawn on six pairs of neighbouring frames of each clip.",
        f"The last column, {DEEP}: on the same frames held in 12 bits; it tells what rounding to 8 costs.",
    ]
    if about["unusable_portraits"]:
        lines.append(f"Portraits without a usable face: {', '.join(about['unusable_portraits'])}.")
    absent = [clip["clip"] for clip in results["clips"] if not clip["paper"]]
    if absent:
        lines.append(f"The paper's settings found no face region, and have no figures, on: {', '.join(absent)}.")
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
        "## Reconstruction and drift of the boundary colours, levels",
        _reconstruction(results),
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
