"""The tables of the speed benchmark."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from benchmarks.growth import paper_costs
from benchmarks.rivals import OURS_NAME
from benchmarks.stages import KEY_FRAME_STAGES, LOOK_STAGES
from benchmarks.targets import FRAMES, LOOKS, Target

Results = Mapping[str, Any]

_VERDICT = {True: "met", False: "MISSED", None: ""}


def _number(value: float) -> str:
    size = abs(value)
    if size >= 100:
        return f"{value:.0f}"
    return f"{value:.2f}" if size >= 1 else f"{value:.3f}"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Columns as wide as they need, the first one to the left, a last one called "note" too."""
    widths = [max(len(row[k]) for row in [head, *rows]) for k in range(len(head))]
    lines = []
    for row in [head, ["-" * width for width in widths], *rows]:
        cells = [
            cell.ljust(width) if k == 0 or head[k] == "note" else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


def target_table(rows: Sequence[Target]) -> str:
    """Every target beside what was measured."""
    cells = []
    for row in rows:
        spread = "" if row.low == row.high else f"{_number(row.low)}-{_number(row.high)}"
        sign = "<=" if row.at_most else ">="
        wanted = "" if row.target is None else f"{sign} {row.target:g}" if row.target < 1000 else f"{sign} 1000"
        cells.append([row.what, _number(row.value), row.unit, spread, wanted, _VERDICT[row.met], row.note])
    return _table(["what", "median", "unit", "least-most", "target", "", "note"], cells)


def _stage_table(results: Results) -> str:
    near = results.get("close-up stages")
    cells = []
    for name, value in results["stages"]["ms"].items():
        often = "key frame" if name in KEY_FRAME_STAGES else "look" if name in LOOK_STAGES else "frame"
        far = "" if near is None else _number(near["ms"][name]["median"])
        cells.append([name, _number(value["median"]), f"{_number(value['min'])}-{_number(value['max'])}", far, often])
    head = ["stage", "CPU ms", "least-most", "large face", "a"]
    return _table(head, cells)


def _run_table(results: Results) -> str:
    runs = results["runs"]
    transcode = runs["s"]["transcode"]["median"]
    cells = [
        [
            name,
            _number(value["median"]),
            f"{_number(value['min'])}-{_number(value['max'])}",
            _number(value["cpu"]["median"]),
            _number(value["median"] / transcode),
        ]
        for name, value in runs["s"].items()
    ]
    if "http" in results:
        taken = sorted(results["http"]["transfer"])
        middle = taken[len(taken) // 2]
        ratio = middle / transcode
        cells.append(
            ["one look over HTTP", _number(middle), f"{_number(taken[0])}-{_number(taken[-1])}", "", f"{ratio:.2f}"]
        )
    sizes = runs["bytes"]
    look = f"The first look's file is {sizes['look-0'] / sizes['transcoded']:.2f} times as large as the transcode's."
    return f"{_table(['whole run', 'wall s', 'least-most', 'CPU s', '/ transcode'], cells)}\n{look}"


def _rival_table(results: Results) -> str:
    """A frame, and a clip of 600 frames in one and in ten looks without decoding and encoding."""
    near = results.get("close-up rivals")
    vectorised = _vectorised_frame_s(results)
    once = results["rivals"]["once_ms"]
    shared = _shared_by_looks(results)
    cells = []
    for name, value in results["rivals"]["ms"].items():
        frame = value["median"]
        start = once.get(name, {"median": 0.0})["median"] / 1000.0
        costs = []
        for looks in (1, LOOKS):
            if name == OURS_NAME:
                drawn = FRAMES * (frame - shared + looks * shared) / 1000.0
                costs.append(FRAMES * vectorised + looks * start + drawn)
            else:
                costs.append(looks * (start + FRAMES * frame / 1000.0))
        far = "" if near is None else _number(near["ms"][name]["median"])
        cells.append([name, _number(frame), far, *map(_number, costs)])
    cells.sort(key=lambda row: float(row[1]))
    return _table(["method", "ms a frame", "large face", "clip, 1 look: s", f"{LOOKS} looks: s"], cells)


def _vectorised_frame_s(results: Results) -> float:
    """CPU seconds of vectorising one frame, from the whole runs."""
    if "runs" not in results:
        return 0.0
    return float(results["runs"]["s"]["vectorise"]["cpu"]["median"] / results["runs"]["frames"])


def _shared_by_looks(results: Results) -> float:
    """Milliseconds that a further look adds to a drawn frame: its membrane and its application."""
    if "stages" not in results:
        return 0.0
    ms = results["stages"]["ms"]
    return float(ms["membrane"]["median"] + ms["apply"]["median"])


def _growth_lines(results: Results) -> Iterator[str]:
    growth = results["growth"]
    frames, looks = growth["frames"], growth["looks"]
    for name, fit in frames["fits"].items():
        yield (
            f"frames: {name}: {fit['slope'] * 1000:.2f} ms a frame + {fit['intercept']:.2f} s "
            f"(R2 {fit['r2']:.4f}, log-log slope {fit.get('log_slope', float('nan')):.2f})"
        )
    for name, fit in looks["fits"].items():
        yield f"looks:  {name}: {fit['slope']:.3f} s a look + {fit['intercept']:.2f} s (R2 {fit['r2']:.4f})"
    yield (
        f"looks:  a further look costs {looks['further look ms']:.2f} ms a frame, its encode alone "
        f"{looks['encode ms']:.2f} ms: {looks['further look / encode']:.2f}"
    )


def _size_table(results: Results) -> str:
    out = []
    for kind, part in results["sizes"].items():
        x = part["x"]
        rows = part["rows"]
        head = [f"CPU ms by {kind} size", *(f"{row[x]:.2f} MP" for row in rows), "ms a MP", "+ ms", "R2"]
        if kind == "face":
            head[1:-3] = [f"{row['face_px']:.0f} px" for row in rows]
        cells = [
            [
                name,
                *(_number(row[name]) for row in rows),
                _number(fit["slope"]),
                _number(fit["intercept"]),
                f"{fit['r2']:.2f}",
            ]
            for name, fit in part["fits"].items()
        ]
        out.append(_table(head, cells))
    return "\n\n".join(out)


def _cost_table(results: Results) -> str:
    out = []
    for name, times in results["cost analysis"]["times"].items():
        symbols = ", ".join(f"{symbol} {_number(value)}" for symbol, value in times.items())
        costs = {m: paper_costs(times, FRAMES, m) for m in (1, 3, LOOKS, 30)}
        cells = [[way, *(_number(cost[way]) for cost in costs.values())] for way in costs[1]]
        head = [f"{FRAMES} frames, CPU s", *(f"{m} look{'s' * (m > 1)}" for m in costs)]
        out.append(f"{name}; ms: {symbols}\n{_table(head, cells)}")
    return "\n\n".join(out)


_PARTS = (
    ("Stages, one core", "stages", _stage_table),
    ("Whole runs, in turns", "runs", _run_table),
    ("Peers on the same frames, masks and reference, one core", "rivals", _rival_table),
    ("Growth with frames and looks", "growth", lambda results: "\n".join(_growth_lines(results))),
    ("Growth with face and clip size", "sizes", _size_table),
    ("The paper's cost analysis with these times", "cost analysis", _cost_table),
)


def tables(results: Results, rows: Sequence[Target]) -> str:
    """All tables of what was measured."""
    parts = [f"Targets\n\n{target_table(rows)}"] if rows else []
    parts += [f"{title}\n\n{table(results)}" for title, needs, table in _PARTS if needs in results]
    return "\n\n\n".join(parts)
