"""How cost grows with frames, looks, face and clip size, and the paper's cost analysis with measured times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import pvg
from benchmarks.alone import run_alone
from benchmarks.clips import Window, encode, make_clip
from benchmarks.runs import Job, further_looks, transfer
from benchmarks.stages import stage_times
from benchmarks.timing import in_turns, seconds
from pvg.video import probe

Rows = list[dict[str, float]]

_LONGER_SIDE = 960  # the clip is scaled down to this for the growth with frames and looks
_ENCODES = 3
_ROOM = 1.35  # shorter side of a picture over the width of a face that is all in it
_STAGES_OF_SIZE = ("detect", "landmarks", "mask", "curves", "membrane", "apply", "decode", "encode", "to RGB")


def linear_fit(x: Sequence[float], y: Sequence[float]) -> dict[str, float]:
    """y = a + b x by least squares, its R², and the slope of log y over log x."""
    xs, ys = np.asarray(x, np.float64), np.asarray(y, np.float64)
    slope, intercept = np.polyfit(xs, ys, 1)
    left = ys - (intercept + slope * xs)
    total = float(((ys - ys.mean()) ** 2).sum())
    fit = {"slope": float(slope), "intercept": float(intercept)}
    fit["r2"] = 1.0 - float((left**2).sum()) / total if total > 0 else 1.0
    if (xs > 0).all() and (ys > 0).all():
        fit["log_slope"] = float(np.polyfit(np.log(xs), np.log(ys), 1)[0])
    return fit


def _halved_window(clip: Path) -> Window:
    info = probe(clip)
    scale = min(1.0, _LONGER_SIDE / max(info.width, info.height))
    width, height = (round(n * scale) // 2 * 2 for n in (info.width, info.height))
    return Window((info.width - 1) / 2, (info.height - 1) / 2, width, height, scale)


def _vectorise(job: Job) -> None:
    pvg.vectorize(job.clip, asset=job.asset).close()


def over_frames(clip: Path, folder: Path, references: tuple[Path, ...], counts: Sequence[int]) -> dict[str, Any]:
    """CPU and wall seconds of vectorising and of one look for clips of `counts` frames."""
    rows: Rows = []
    for count in counts:
        source = make_clip(clip, folder / f"frames-{count}.mp4", count, _halved_window(clip))
        job = Job(source, folder / f"frames-{count}.pvg", references)
        vectorised = seconds(partial(_vectorise, job))
        stage = seconds(partial(job.looks, 1))
        drawn = seconds(partial(transfer, job, 1, folder))
        rows.append(
            {
                "frames": count,
                "vectorise": vectorised[1],
                "transfer stage": stage[1],
                "transfer": drawn[1],
                "vectorise wall": vectorised[0],
                "transfer wall": drawn[0],
            }
        )
    x = [row["frames"] for row in rows]
    names = ("vectorise", "transfer stage", "transfer")
    info = probe(folder / f"frames-{counts[0]}.mp4")
    fits = {name: linear_fit(x, [row[name] for row in rows]) for name in names}
    return {"rows": rows, "fits": fits, "size": [info.width, info.height]}


def over_looks(folder: Path, references: tuple[Path, ...], frames: int, counts: Sequence[int]) -> dict[str, Any]:
    """CPU and wall seconds of requests of `counts` looks, on the clip of `over_frames` with `frames` frames."""
    job = Job(folder / f"frames-{frames}.mp4", folder / f"frames-{frames}.pvg", references)
    rows: Rows = []
    for count in counts:
        stage = seconds(partial(job.looks, count))
        drawn = seconds(partial(transfer, job, count, folder))
        rows.append({"looks": count, "transfer stage": stage[1], "transfer": drawn[1], "transfer wall": drawn[0]})
    x = [row["looks"] for row in rows]
    fits = {name: linear_fit(x, [row[name] for row in rows]) for name in ("transfer stage", "transfer")}
    encoding = _encode_ms(job, folder, frames)
    further = fits["transfer"]["slope"] * 1000.0 / frames
    shares = {"further look ms": further, "encode ms": encoding, "further look / encode": further / encoding}
    return {"rows": rows, "fits": fits, "frames": frames, **shares}


def _encode_ms(job: Job, folder: Path, count: int) -> float:
    """CPU milliseconds a frame of encoding a look's pictures alone, with as many threads as in a request."""
    info, pictures = probe(job.clip), further_looks(job)
    works = {str(k): lambda h=held: encode(folder / "encoded.mp4", info, h, count) for k, held in enumerate(pictures)}
    taken = in_turns(works, _ENCODES)
    return float(np.mean([one.cpu.median for one in taken.values()])) * 1000.0 / count


def _face_of(job: Job) -> tuple[float, float, float]:
    """x, y of the face's centre and its width in the clip's first face frame."""
    with pvg.open_asset(job.asset, job.clip) as video:
        face = max(video.faces, key=lambda summary: summary.width_px)
        data = video.face_at(face.index, face.first_frame)
        assert data is not None
        axes = data.landmarks.axes
        return float(axes.center[0]), float(axes.center[1]), axes.width


def face_windows(job: Job, widths: Sequence[int]) -> dict[int, Window]:
    """Windows on a face drawn `widths` pixels wide, as large as the clip or as the widest face needs."""
    x, y, width = _face_of(job)
    info = probe(job.clip)
    enlarged = max(1.0, _ROOM * max(widths) / min(info.width, info.height))
    across, down = (round(side * enlarged) // 2 * 2 for side in (info.width, info.height))
    return {wanted: Window(x, y, across, down, wanted / width) for wanted in widths}


def clip_windows(job: Job, factors: Sequence[float]) -> dict[float, Window]:
    """Windows `factors` times the clip's sides about its face, which keeps its size."""
    x, y, _ = _face_of(job)
    info = probe(job.clip)
    sizes = {factor: tuple(round(side * factor) // 2 * 2 for side in (info.width, info.height)) for factor in factors}
    return {factor: Window(x, y, w, h, 1.0) for factor, (w, h) in sizes.items()}


def over_sizes(
    job: Job, folder: Path, faces: Mapping[int, Window], clips: Mapping[float, Window], *, length: int, frames: int
) -> dict[str, Any]:
    """CPU milliseconds of the stages over `frames` frames, for faces and for clips of several sizes, `length` long."""
    out: dict[str, Any] = {}
    for kind, windows in (("face", faces), ("clip", clips)):
        rows: Rows = []
        for number, window in enumerate(windows.values()):
            clip = make_clip(job.clip, folder / f"{kind}-{number}.mp4", length, window)
            asset = folder / f"{kind}-{number}.pvg"
            pvg.vectorize(clip, asset=asset).close()
            alone = run_alone(stage_times, clip, asset, job.references[0], frames, one_thread=True).result
            box = alone["box_px"]
            row = {"face_px": alone["face_px"], "megapixels": window.width * window.height / 1e6}
            row["box_megapixels"] = box[0] * box[1] / 1e6
            rows.append(row | {name: alone["ms"][name]["median"] for name in _STAGES_OF_SIZE})
        size = "box_megapixels" if kind == "face" else "megapixels"
        x = [row[size] for row in rows]
        fits = {name: linear_fit(x, [row[name] for row in rows]) for name in _STAGES_OF_SIZE}
        out[kind] = {"rows": rows, "fits": fits, "x": size}
    return out


def cost_times(stages: Mapping[str, Any], raster_ms: float) -> dict[str, float]:
    """The symbols of the paper's cost analysis in milliseconds, from stage medians."""
    ms = {name: value["median"] for name, value in stages.items()}
    follow = ms["landmarks"] + ms["mask"]
    return {
        "T_OMT": raster_ms,
        "T_V": follow + ms["detect"] + ms["skin model"] + ms["fit"],
        "T_V-OMT": ms["look"],
        "T_follow": follow,
        "T_match": ms["match"],
        "T_R": ms["curves"] + ms["membrane"] + ms["apply"],
        "T_decode": ms["decode"],
        "T_encode": ms["encode"],
    }


def paper_costs(t: Mapping[str, float], n: int, m: int) -> dict[str, float]:
    """Seconds of the paper's three ways for n frames and m looks, and those of coding, the same for all three.

    raster transport: m n T_OMT;  per-frame vectorisation: n T_V + m n T_V-OMT + m n T_R;
    ours: T_V + (n - 1) T_follow + m T_V-OMT + m n (T_match + T_R). The paper writes T_match for what a further
    frame costs in vectorising; ours is T_follow, its landmarks and mask.
    """
    ways = {
        "raster transport": m * n * t["T_OMT"],
        "per-frame vectorisation": n * t["T_V"] + m * n * (t["T_V-OMT"] + t["T_R"]),
        "ours": t["T_V"] + (n - 1) * t["T_follow"] + m * t["T_V-OMT"] + m * n * (t["T_match"] + t["T_R"]),
        "decoding and encoding": n * t["T_decode"] + m * n * t["T_encode"],
    }
    return {name: milliseconds / 1000.0 for name, milliseconds in ways.items()}
