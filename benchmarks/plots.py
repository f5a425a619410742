"""Plots of the speed report; matplotlib comes with the `bench` extra."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
from matplotlib import pyplot as plt

from benchmarks.growth import paper_costs
from benchmarks.targets import FRAMES

Results = Mapping[str, Any]
_MOST_LOOKS = 50


def draw_plots(results: Results, out: Path) -> list[str]:
    """Write the plots that the results allow into `out` and return their file names."""
    drawn = []
    for name, needs, draw in (
        ("targets.png", "targets", _targets),
        ("stages.png", "stages", _stages),
        ("rivals.png", "rivals", _rivals),
        ("growth.png", "growth", _growth),
        ("sizes.png", "sizes", _sizes),
        ("cost-analysis.png", "cost analysis", _costs),
    ):
        if needs in results:
            figure = draw(results)
            figure.savefig(out / name, dpi=110)
            plt.close(figure)
            drawn.append(name)
    return drawn


def _targets(results: Results) -> Any:
    """Measured over target, so that 1 is the target; for "faster" the other way round."""
    rows = [row for row in results["targets"] if row["target"] is not None]
    figure, axes = plt.subplots(figsize=(9, 0.32 * len(rows) + 1.2), layout="constrained")
    values = [r["value"] / r["target"] if r["at_most"] else r["target"] / r["value"] for r in rows]
    places = range(len(rows), 0, -1)
    colors = ["tab:green" if row["met"] else "tab:red" for row in rows]
    axes.hlines(places, values, 1.0, color=colors)
    axes.scatter(values, places, color=colors)
    axes.axvline(1.0, color="black", linewidth=1)
    axes.set_yticks(list(places), [row["what"].strip() for row in rows], fontsize=8)
    axes.set(xscale="log", xlabel="measured / target (at most 1 is met)")
    return figure


def _stages(results: Results) -> Any:
    ms = {name: value["median"] for name, value in results["stages"]["ms"].items() if name != "draw in all"}
    names = sorted(ms, key=lambda name: ms[name])
    figure, axes = plt.subplots(figsize=(8, 4.5), layout="constrained")
    _dots(axes, names, [ms[name] for name in names], "%.2f")
    axes.set(xlabel="CPU ms on one core, a frame (key-frame and look stages: a call)")
    return figure


def _dots(axes: Any, names: list[str], values: list[float], form: str) -> None:
    """A dot a name on a logarithmic axis (a bar would have no foot there), its value beside it."""
    axes.scatter(values, names)
    for name, value in zip(names, values, strict=True):
        axes.annotate(form % value, (value, name), (6, 0), textcoords="offset points", fontsize=8, va="center")
    axes.set_xscale("log")
    axes.grid(axis="x", alpha=0.3)
    axes.margins(x=0.15)


def _rivals(results: Results) -> Any:
    kinds = [kind for kind in ("rivals", "close-up rivals") if kind in results]
    figure, panels = plt.subplots(1, len(kinds), figsize=(7 * len(kinds), 4), layout="constrained", squeeze=False)
    for axes, kind in zip(panels[0], kinds, strict=True):
        ms = {name: value["median"] for name, value in results[kind]["ms"].items()}
        names = sorted(ms, key=lambda name: ms[name])
        _dots(axes, names, [ms[name] for name in names], "%.1f")
        axes.set(xlabel="CPU ms a frame, one core", title=f"face {results[kind]['face_px']:.0f} px")
    return figure


def _growth(results: Results) -> Any:
    growth = results["growth"]
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
    for axes, part, x, names in (
        (left, growth["frames"], "frames", ("vectorise", "transfer", "transfer stage")),
        (right, growth["looks"], "looks", ("transfer", "transfer stage")),
    ):
        places = [row[x] for row in part["rows"]]
        line = np.linspace(0, max(places), 50)
        for name in names:
            fit = part["fits"][name]
            points = axes.plot(places, [row[name] for row in part["rows"]], "o", label=name)
            axes.plot(line, fit["intercept"] + fit["slope"] * line, color=points[0].get_color(), linewidth=1)
        axes.set(xlabel=x, ylabel="CPU seconds", ylim=(0, None), xlim=(0, None))
        axes.legend(fontsize=8)
    return figure


def _sizes(results: Results) -> Any:
    figure, panels = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
    for axes, (kind, part) in zip(panels, results["sizes"].items(), strict=True):
        rows = sorted(part["rows"], key=lambda row: row[part["x"]])
        for name in part["fits"]:
            axes.plot([r[part["x"]] for r in rows], [r[name] for r in rows], "o-", label=name, markersize=3)
        what = "the face's box" if kind == "face" else "the clip"
        axes.set(xscale="log", yscale="log", xlabel=f"megapixels of {what}", ylabel="CPU ms a frame, one core")
        axes.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def _costs(results: Results) -> Any:
    analysis = results["cost analysis"]
    looks = np.arange(1, _MOST_LOOKS + 1)
    panels = [(name, times) for name, times in analysis["times"].items() if times]
    figure, axes = plt.subplots(1, len(panels), figsize=(6.5 * len(panels), 4.2), layout="constrained", squeeze=False)
    for panel, (name, times) in zip(axes[0], panels, strict=True):
        costs = [paper_costs(times, FRAMES, int(m)) for m in looks]
        for way in costs[0]:
            style = "--" if way == "decoding and encoding" else "-"
            panel.plot(looks, [cost[way] for cost in costs], style, label=way)
        panel.set(xlabel="looks", ylabel=f"CPU s, {FRAMES} frames", yscale="log", title=name)
        panel.legend(fontsize=8)
    return figure
