"""The report: Markdown, JSON, plots and contact sheets out of the measured results."""

from __future__ import annotations

import json
import platform
from operator import itemgetter
from pathlib import Path
from typing import Any

from benchmarks.quality.clips import COLOR_FRAMES, COSTLY_FRAMES, MOTION_PAIRS, strip_columns
from benchmarks.quality.color import TONE_GROUPS, tone_group
from benchmarks.quality.peers import DEEP, MK, OURS, PAPER, full_options, has_option, method_names
from benchmarks.quality.plots import draw_plots
from benchmarks.quality.regions import UNCHANGED, regions_table
from benchmarks.quality.sheets import save_sheet
from benchmarks.quality.summary import (
    HEADLINE,
    MEASURES,
    Results,
    case_rows,
    closer,
    color_rows,
    mean,
    median,
    number,
    percentile,
    summary_table,
    table,
)

_WORST = 3


def _groups(results: Results, of_clip: bool) -> str:
    """Measures of the headline method by skin-tone group of the clip or the reference."""
    tones = {clip["clip"]: clip["ita"] for clip in results["clips"]}

    def group(row: dict[str, Any]) -> str:
        return tone_group(tones[row["clip"]] if of_clip else row["reference_ita"])

    rows = []
    for name in TONE_GROUPS:
        cases = [case for case in case_rows(results, HEADLINE) if group(case) == name]
        colors = [row for row in color_rows(results, HEADLINE) if group(row) == name]
        if not colors:
            continue
        others = [[r for r in color_rows(results, m) if group(r) == name] for m in (PAPER, MK)]
        rows.append(
            [
                name,
                str(len(colors)),
                number(mean(c["steady_face"] for c in cases), 4),
                number(median([c["warping_face"] for c in cases if c["warping_face"] is not None]), 3),
                number(mean(c["detail"] for c in cases), 4),
                number(closer(colors), 1),
                *(number(percentile(colors, "delta_e", share), 2) for share in (50, 90)),
                *(number(percentile(part, "delta_e", 50), 2) for part in others),
            ]
        )
    head = ["group", "pairs", "steadiness, face", "warping, face", "detail", "closer, %", "ΔE median", "ΔE p90"]
    return table([*head, "ΔE median, paper's", "ΔE median, masked MK"], rows)


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
        [case["clip"], case["reference"], *(number(case.get(key), digits) for key, _, digits in _CASE_COLUMNS)]
        for case in case_rows(results, method)
    ]
    return table(["clip", "reference", *(title for _, title, _ in _CASE_COLUMNS)], rows)


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
        rows = color_rows(results, HEADLINE) if colors else case_rows(results, HEADLINE)
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
            rows.append([clip["clip"], way, number(mean(values), 2), *(number(value, 1) for value in values)])
    width = max((len(row) for row in rows), default=3)
    head = ["clip", "way", "mean", *(f"{100 * k / max(1, width - 4):.0f} %" for k in range(width - 3))]
    return table(head, [row + ["–"] * (width - len(row)) for row in rows])


def _ramps(results: Results) -> str:
    rows = []
    for row in results["ramp"]:
        deltas = row["delta_e"]
        shown = [deltas[0], deltas[len(deltas) // 2], deltas[-1], max(deltas)]
        direction = "up" if row["up"] else "down"
        rows.append(
            [
                *(row["clip"], direction, row["reference"], row["method"]),
                *(number(value, 1) for value in (100 * row["white"], *shown)),
                *(number(row[key], 2) for key in ("step", "step_in")),
            ]
        )
    head = ["clip", "gain", "reference", "method", "at white, %", "ΔE first", "middle", "last", "worst"]
    return table([*head, "largest step", "the input's"], rows)


def _regions(results: Results) -> str:
    rows = [row for row in results["regions"] if row["method"] == HEADLINE]
    if not rows:
        return "Not measured: no labelled regions of these files."
    unchanged = (line for line in results["regions_left_out"] if line.endswith(UNCHANGED))
    others = {line for line in unchanged if f", {HEADLINE}: " not in line}
    left_out = [line for line in results["regions_left_out"] if line not in others]
    return "\n".join([regions_table(rows), *(f"- left out: {line}" for line in left_out)])


def _leaks(results: Results) -> str:
    rows = [[row["scene"], row["reference"] or "–", row["method"], number(row["leak"], 3)] for row in results["leak"]]
    return table(["scene", "reference", "method", "std of the face's mean, levels"], rows)


def _masks(results: Results) -> str:
    if not results["masks"]:
        return "Not measured: there are no labelled portraits here."
    keys = [key for key in results["masks"][0] if key != "portrait"]
    rows = [[row["portrait"], *(number(row[key], 3) for key in keys)] for row in results["masks"]]
    return table(["portrait", *keys], rows)


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
    summary_text = summary_table(results)
    plots = draw_plots(results, out)
    parts = [
        "# Quality",
        "\n".join(f"- {line}" for line in _notes(results)),
        "## Summary",
        summary_text,
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
    return f"{summary_text}\n\n{out / 'report.md'}"
