"""Stage times and whole runs on one clip; see README.md."""

from __future__ import annotations

import json
import os
import platform
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import pvg
from benchmarks.stages import stage_times
from pvg.video import VideoWriter, probe, read_frames
from scripts.samples import REPOSITORY, fetch_samples

OUT = REPOSITORY / "benchmarks" / "out"
REPEATS = 3


def timed(work: Callable[[], Any]) -> dict[str, float]:
    """Median seconds of `REPEATS` runs and their relative spread."""
    seconds = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    median = statistics.median(seconds)
    return {"s": median, "spread": (max(seconds) - min(seconds)) / median}


def decode(clip: Path) -> None:
    """Read every frame's planes."""
    for _ in read_frames(clip):
        pass


def transcode(clip: Path, target: Path) -> None:
    """Decode and encode with the settings a transfer uses, sound copied."""
    info = probe(clip)
    with VideoWriter(target, info, info.format, audio_from=clip) as writer:
        for frame in read_frames(clip):
            writer.write(frame)


def whole_runs(clip: Path, references: list[Path], folder: Path) -> dict[str, dict[str, float]]:
    """Decode, transcode, vectorise, transfer with one and two looks."""
    asset = folder / "clip.pvg"
    pvg.vectorize(clip, asset=asset).close()  # compiles and warms up
    runs = {
        "decode": timed(lambda: decode(clip)),
        "transcode": timed(lambda: transcode(clip, folder / "transcode.mp4")),
        "vectorize clip": timed(lambda: pvg.vectorize(clip, asset=asset).close()),
        "vectorize reference": timed(lambda: pvg.vectorize(references[0], reference=True).close()),
    }
    with pvg.open_asset(asset, clip) as video:
        video.require_source()
        looks = [pvg.transfer(video, pvg.vectorize(reference, reference=True)) for reference in references]
        for count in (1, 2):
            paths = [folder / f"look-{i}.mp4" for i in range(count)]
            runs[f"render {count} look{'s' * (count > 1)}"] = timed(
                lambda n=count, to=paths: pvg.render(video, looks[:n], to)
            )
    return runs


def main() -> None:
    """Print the tables and write them as JSON."""
    samples = fetch_samples()
    clip = Path(sys.argv[1]) if len(sys.argv) > 1 else samples.woman_clip
    info = probe(clip)
    print(f"{clip.name}: {info.width}x{info.height}, {info.frame_count} frames, {os.cpu_count()} cores")
    with tempfile.TemporaryDirectory() as folder:
        runs = whole_runs(clip, [samples.dark_portrait, samples.pale_portrait], Path(folder))
        stages = stage_times(clip, samples.dark_portrait)
    print(f"\n{'whole run':24}{'s':>8}{'spread':>9}{'/ decode':>10}{'/ transcode':>13}")
    for name, run in runs.items():
        against = run["s"] / runs["decode"]["s"], run["s"] / runs["transcode"]["s"]
        print(f"{name:24}{run['s']:8.2f}{run['spread']:8.0%}{against[0]:11.2f}{against[1]:13.2f}")
    per_frame = runs["decode"]["s"] / info.frame_count * 1000
    print(f"\n{'stage':24}{'ms':>8}{'/ decode':>10}   (median; decode is {per_frame:.2f} ms a frame)")
    for name, milliseconds in stages.items():
        print(f"{name:24}{milliseconds:8.2f}{milliseconds / per_frame:10.2f}")
    OUT.mkdir(parents=True, exist_ok=True)
    machine = {"python": platform.python_version(), "cores": os.cpu_count(), "machine": platform.machine()}
    machine |= {"numpy": np.__version__, "opencv": cv2.__version__}
    report = {"clip": clip.name, "frames": info.frame_count, "machine": machine, "runs": runs, "stages_ms": stages}
    (OUT / "stages.json").write_text(json.dumps(report, indent=2))
    print(f"\n{(OUT / 'stages.json').relative_to(REPOSITORY)}")


if __name__ == "__main__":
    main()
