"""Plots of the report; without matplotlib there are none."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from benchmarks.quality.peers import DEEP, method_names

plt: Any = None
try:
    import matplotlib as mpl

    mpl.use("Agg")
    plt = importlib.import_module("matplotlib.pyplot")
except ImportError:
    pass


def draw_plots(results: dict[str, Any], out: Path) -> list[str]:
    """Write the plots into `out` and return their file names."""
    if plt is None:
        return []
    drawn = []
    for name, draw in (
        ("steadiness.png", _steadiness),
        ("truth.png", _truth),
        ("leak.png", _leak),
        ("delta-e.png", _delta_e),
    ):
        figure, axes = plt.subplots(figsize=(8, 4.2), layout="constrained")
        axes.set_prop_cycle(color=plt.get_cmap("tab20").colors[::2] + plt.get_cmap("tab20").colors[1::2])
        draw(axes, results)
        figure.savefig(out / name, dpi=110)
        plt.close(figure)
        drawn.append(name)
    return drawn


def _steadiness(axes: Any, results: dict[str, Any]) -> None:
    """PSNR(in, out) frame by frame about its mean, in the first clip with the first reference (Fig. 10)."""
    clip = results["clips"][0]
    reference = clip["cases"][0]["reference"]
    for case in clip["cases"]:
        values = case["psnr_whole"]
        if case["reference"] == reference and len(values) == clip["frames"] and case["method"] != DEEP:
            mean = sum(values) / len(values)
            axes.plot([value - mean for value in values], label=case["method"], linewidth=1)
    axes.set(title=f"{clip['clip']} with {reference}", xlabel="frame", ylabel="PSNR(in, out) - mean, dB")
    axes.legend(fontsize=7)


def _truth(axes: Any, results: dict[str, Any]) -> None:
    """How far g is from a fit to the frame, every clip (Fig. 11)."""
    for clip in results["truth"]:
        frames = [row["frame"] for row in clip["rows"]]
        axes.plot(frames, [row["table"] for row in clip["rows"]], label=clip["clip"], marker=".", linewidth=1)
    axes.set(title="the clip-wide table", xlabel="frame", ylabel="|H(g) - H(fit)|, levels")
    axes.legend(fontsize=6)


def _leak(axes: Any, results: dict[str, Any]) -> None:
    """The face's mean level while the panel grows, about its first value."""
    first = results["leak"][0]["scene"]
    reference = next(row["reference"] for row in results["leak"] if row["reference"])
    for row in results["leak"]:
        if row["scene"] == first and row["reference"] in ("", reference):
            rise = [value - row["curve"][0] for value in row["curve"]]
            axes.plot(row["frames"], rise, label=row["method"], marker=".", markersize=3, linewidth=1)
    axes.set(title=f"{first} with {reference}", xlabel="frame", ylabel="mean of the face - first, levels")
    axes.legend(fontsize=7)


def _delta_e(axes: Any, results: dict[str, Any]) -> None:
    """CIEDE2000 over all pairs."""
    rows = [row for clip in results["clips"] for row in clip["colors"]]
    names = [name for name in method_names() if any(row["method"] == name for row in rows)]
    values = [[row["delta_e"] for row in rows if row["method"] == name] for name in names]
    axes.boxplot(values, orientation="horizontal", tick_labels=names, whis=(10, 90), showfliers=False)
    axes.invert_yaxis()
    axes.axvline(2.5, linewidth=0.8, linestyle=":")
    axes.set(xlabel="CIEDE2000 of the median face skin to the reference's; box 25-75 %, whiskers 10-90 %")
