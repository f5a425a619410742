"""The targets of speed, each beside what was measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from benchmarks.rivals import EQUAL_ONCE, PLAIN_OMT

Results = Mapping[str, Any]
LOOKS, FRAMES = 10, 600
MEMORY_MB = 1000.0
SIZE_PART, SIZE_FRAME = 0.15, 20_000  # of the source's bytes, or bytes a 1080p frame, whichever is larger
_FULL_HD = 1920 * 1080


@dataclass(frozen=True)
class Target:
    """One row of the table: value beside its target, least and greatest of the repeats, and what to know.

    at_most: False when larger is better.  target None: shown for comparison, not judged.
    """

    what: str
    value: float
    low: float
    high: float
    unit: str
    target: float | None
    at_most: bool = True
    note: str = ""

    @property
    def met(self) -> bool | None:
        """Whether the target is met; None without one."""
        if self.target is None:
            return None
        return self.value <= self.target if self.at_most else self.value >= self.target

    def to_json(self) -> dict[str, Any]:
        """The row with its verdict."""
        return {**asdict(self), "met": self.met}


def _row(what: str, measured: Results, unit: str, target: float | None, note: str = "") -> Target:
    return Target(what, measured["median"], measured["min"], measured["max"], unit, target, note=note)


def _one(what: str, value: float, unit: str, target: float | None, note: str = "", *, at_most: bool = True) -> Target:
    return Target(what, value, value, value, unit, target, at_most, note)


def _color(results: Results) -> list[Target]:
    color = results["color transfer"]
    note = f"{color['frames']} frames, one look"
    if color["measured"] != color["frames"]:
        note += f" (colours of {color['measured']} frames measured)"
    return [_row("colour transfer and all curve colours, a frame", color["ms_per_frame"], "ms", 0.03, note)]


def _membrane(results: Results) -> list[Target]:
    membrane = results["membrane"]
    ms, error, each = membrane["ms"], membrane["errors"], membrane["each"].values()
    unknowns = sum(one["unknowns"] for one in each) // len(each)
    nodes = "x".join(map(str, membrane["nodes"]))
    return [
        _row(
            "membrane, 800x1096 face, one thread", ms["in all"], "ms", 3.0, f"curves, equations, solve; {nodes} nodes"
        ),
        _row("  mean error", error["mean"], "level", 0.15, f"{len(each)} faces, to {unknowns} unknowns solved"),
        _row("  99th percentile of the error", error["p99"], "level", 1.0),
    ]


def _apply(results: Results) -> list[Target]:
    stages = results["stages"]
    kept = "outside bit-exact" if stages["outside_untouched"] else "OUTSIDE CHANGED"
    rows = [_row("applying to a frame, one thread", stages["ms"]["apply"], "ms", 2.0, f"{_face(stages)}; {kept}")]
    close = results.get("close-up stages")
    if close:
        rows.append(_row("  the same, a large face", close["ms"]["apply"], "ms", 2.0, _face(close)))
    return rows


def _face(stages: Results) -> str:
    return f"face {stages['face_px']:.0f} px in {stages['size'][0]}x{stages['size'][1]}"


def _runs(results: Results) -> list[Target]:
    runs = results["runs"]
    ratios = runs["ratios"]

    def row(what: str, name: str, target: float | None) -> Target:
        note = f"{runs['frames']} frames; by CPU time {ratios[name]['cpu']['median']:.2f}"
        return _row(what, ratios[name], "x", target, note)

    return [
        row("/transfer, one look, over a transcode", "one look / transcode", 1.25),
        row("  over the codec library's bare transcode", "one look / bare transcode", None),
        row("each further look, over its encode alone", "further look / encode", 1.15),
        row("vectorising a clip, over decoding it", "vectorise / decode", 3.0),
    ]


def _references(results: Results) -> list[Target]:
    found = results["references"]
    return [
        _row(f"vectorising {what}, weights loaded", found[kind], "s", 0.5, f"{len(found[kind]['each'])} portraits")
        for kind, what in (("reference", "a reference"), ("image", "an image"))
    ]


def _single_frame(results: Results) -> list[Target]:
    frame = results["single frames"]
    return [
        _row("one frame of one look, open asset, p50", frame, "ms", 100.0, f"random places; p90 {frame['p90']:.0f}")
    ]


def end_to_end(results: Results, kind: str) -> dict[str, float]:
    """Seconds for 10 looks of 600 frames by parts; kind: "own" face, or "close-up"."""
    runs = results["runs" if kind == "own" else "close-up runs"]["s"]
    frames = results["runs" if kind == "own" else "close-up runs"]["frames"]
    omt = results["rivals" if kind == "own" else "close-up rivals"]["ms"]
    per_frame = {name: runs[name]["median"] / frames for name in ("one look", "further look", "encode")}
    decode = results["runs"]["s"]["decode"]["median"] / results["runs"]["frames"]
    vectorise = (runs.get("vectorise") or results["runs"]["s"]["vectorise"])["median"] / frames
    coding = FRAMES * decode + LOOKS * FRAMES * per_frame["encode"]
    real = results.get("ten looks") if kind == "own" else None
    ours = FRAMES * (vectorise + per_frame["one look"] + (LOOKS - 1) * per_frame["further look"])
    return {
        "ours": ours if real is None else real["vectorise_s"] + real["transfer_s"],
        "scaled": real is None,
        "raster": LOOKS * FRAMES * omt[PLAIN_OMT]["median"] / 1000.0,
        "raster, equal once": LOOKS * FRAMES * omt[EQUAL_ONCE]["median"] / 1000.0,
        "coding": coding,
    }


def _ten_looks(results: Results) -> list[Target]:
    rows = []
    once = results["color transfer"]["ms_per_frame"]["median"] / 1000.0
    stage = LOOKS * once * results["color transfer"]["frames"]
    for kind, name in (("own", "rivals"), ("close-up", "close-up rivals")):
        if name not in results:
            continue
        costs = end_to_end(results, kind)
        face = _face(results[name])
        equal = costs["raster, equal once"]
        note = f"{face}; equal colours once: {equal / stage:.0f}x"
        what = f"{LOOKS} looks x {FRAMES} frames, raster OMT over ours: transfer stage"
        rows.append(_one(what, costs["raster"] / stage, "x", 100.0, note, at_most=False))
        ours = f"ours {costs['ours']:.0f} s" + (" (scaled)" if costs["scaled"] else " (run in full)")
        whole = (costs["raster"] + costs["coding"]) / costs["ours"]
        note = f"{face}; {ours}; equal colours once: {(equal + costs['coding']) / costs['ours']:.1f}x"
        rows.append(
            _one(f"  end to end, face {results[name]['face_px']:.0f} px", whole, "x", 20.0, note, at_most=False)
        )
    return rows


def _memory(results: Results) -> list[Target]:
    rows = []
    for name, peak in results["memory"].items():
        judged = MEMORY_MB if "10 looks" not in name else None
        rows.append(_one(f"peak memory, {name}", peak, "MB", judged))
    return rows


def asset_budget(source_bytes: int, frames: int, pixels: int) -> float:
    """Bytes that an asset may take a frame: a part of the source's, or so many for its pixels."""
    return max(SIZE_PART * source_bytes / frames, SIZE_FRAME * pixels / _FULL_HD)


def _asset(results: Results) -> list[Target]:
    asset = results["asset"]
    budget = asset_budget(asset["source_bytes"], asset["frames"], asset["pixels"])
    return [_one("asset size, a frame", asset["bytes"] / asset["frames"] / 1e3, "kB", budget / 1e3)]


_ROWS: tuple[tuple[tuple[str, ...], Callable[[Results], list[Target]]], ...] = (
    (("color transfer",), _color),
    (("membrane",), _membrane),
    (("stages",), _apply),
    (("runs",), _runs),
    (("references",), _references),
    (("single frames",), _single_frame),
    (("color transfer", "rivals", "runs"), _ten_looks),
    (("memory",), _memory),
    (("asset",), _asset),
)


def target_rows(results: Results) -> list[Target]:
    """The rows of all that was measured, in the order of the specification."""
    return [row for needs, rows in _ROWS if all(need in results for need in needs) for row in rows(results)]
