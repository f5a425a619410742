"""`python -m benchmarks.quality`: measure, compare, write the report; see ../README.md."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pvg
from benchmarks.quality.clips import ClipJob, run_clip, vectorize_clip
from benchmarks.quality.labels import LABELS, Label, read_labels
from benchmarks.quality.leak import run_leak
from benchmarks.quality.masks import run_masks
from benchmarks.quality.media import HALVES, Material, choose, find_material, half_of
from benchmarks.quality.peers import missing
from benchmarks.quality.ramp import run_ramp
from benchmarks.quality.regions import STRONG, run_regions
from benchmarks.quality.report import write_report
from benchmarks.quality.truth import run_truth
from scripts.samples import REPOSITORY

OUT = REPOSITORY / "benchmarks" / "out" / "quality"
_QUICK_CLIPS = ("man_deep_brown", "man_tan_backlit", "woman_pale_redhair")
_RAMP_CLIPS = ("man_east_asian_greenscreen", "woman_medium_brown")
REFERENCES_A_CLIP = 2  # of those over time


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.quality", description=__doc__)
    parser.add_argument("--clips", help="comma-separated parts of clip names; all when left out")
    parser.add_argument("--half", choices=HALVES, default="all", help="every second clip by name, or all")
    parser.add_argument("--references", help="comma-separated parts of portrait names for the measures over time")
    parser.add_argument("--frames", type=int, help="the first frames of each clip alone (whole clips; 24 with --quick)")
    parser.add_argument("--labels", type=Path, default=LABELS, help="folder of the labelled regions")
    parser.add_argument("--quick", action="store_true", help="3 clips, 2 references, 24 frames")
    parser.add_argument("--out", type=Path, default=OUT, help="folder of the report")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes")
    return parser.parse_args()


def _chosen(options: argparse.Namespace) -> tuple[Material, int | None]:
    """What to run on, and frames a clip, None for all."""
    material = find_material()
    clips = half_of(choose(material.clips, options.clips), options.half)
    references = choose(material.portraits, options.references) if options.references else material.references
    portraits, labelled = material.portraits, material.labelled
    if options.quick:
        quick = tuple(clip for clip in clips if clip.stem.startswith(_QUICK_CLIPS))
        clips = clips if options.clips else quick or clips
        references = references[:3:2]
        portraits = tuple(dict.fromkeys((*references, *portraits[::4])))
    frames = options.frames or (24 if options.quick else None)
    return Material(clips, references, portraits, labelled, material.source), frames


def _vectorize_portrait(portrait: Path, asset: Path) -> str | None:
    """Write a reference's asset; returns why it cannot serve."""
    try:
        pvg.vectorize(portrait, asset=asset, reference=True).close()
    except pvg.PvgError as error:
        return str(error)
    return None


def _timed(function: Callable[..., Any], *arguments: Any, **named: Any) -> tuple[Any, float]:
    """A result, and the processor time in seconds that it took."""
    start = time.process_time()
    return function(*arguments, **named), time.process_time() - start


class _Progress:
    """One line a finished piece of work; processor_s: of all of it."""

    def __init__(self) -> None:
        self._start = time.perf_counter()
        self.processor_s = 0.0

    def wait(self, work: dict[str, Future[Any]]) -> dict[str, Any]:
        """The results of named pieces of work, in order."""
        out = {}
        for name, future in work.items():
            out[name], taken = future.result()
            self.processor_s += taken
            print(f"{time.perf_counter() - self._start:6.0f} s  {name} ({taken:.0f} s of processor time)", flush=True)
        return out


def _prepare(
    pool: ProcessPoolExecutor, progress: _Progress, material: Material, folder: Path
) -> tuple[dict[Path, Path], dict[str, str]]:
    """Vectorise all portraits and clips into `folder`; returns portrait -> asset and clip -> the paper's failure."""
    portraits = {path: folder / f"{path.stem}.reference.pvg" for path in {*material.references, *material.portraits}}
    work: dict[str, Future[Any]] = {}
    for path, asset in portraits.items():
        work[f"reference {path.stem}"] = pool.submit(_timed, _vectorize_portrait, path, asset)
    for clip in material.clips:
        for paper in (False, True):
            asset = folder / f"{clip.stem}{'.paper' * paper}.pvg"
            name = f"vectorise {clip.stem}{' as the paper' * paper}"
            work[name] = pool.submit(_timed, vectorize_clip, clip, asset, paper=paper)
    done = progress.wait(work)
    usable = {path: asset for path, asset in portraits.items() if done[f"reference {path.stem}"] is None}
    failures = {clip.stem: done[f"vectorise {clip.stem} as the paper"] for clip in material.clips}
    return usable, {name: why for name, why in failures.items() if why is not None}


@dataclass(frozen=True)
class _Run:
    """What is measured: files, frames a clip, labelled regions by file, and where assets and strips are.

    usable: portrait -> asset.
    """

    material: Material
    frames: int | None
    labels: dict[Path, list[Label]]
    usable: dict[Path, Path]
    folder: Path
    strips: Path

    def assets(self, clip: Path) -> tuple[Path, Path]:
        """Of a clip or still: ours, and the one with the paper's chain."""
        return self.folder / f"{clip.stem}.pvg", self.folder / f"{clip.stem}.paper.pvg"

    def of_time(self, nth: int) -> dict[Path, Path]:
        """The references that the nth clip is measured with over time."""
        known = [path for path in self.material.references if path in self.usable]
        step = max(1, len(known) // REFERENCES_A_CLIP)
        chosen = dict.fromkeys(known[(nth + k * step) % len(known)] for k in range(REFERENCES_A_CLIP))
        return {path: self.usable[path] for path in chosen}

    @property
    def strong(self) -> dict[Path, Path]:
        """A pale and a brown reference."""
        named = {path: asset for path, asset in self.usable.items() if path.stem in STRONG}
        return named or dict(list(self.usable.items())[:2])


def _measure(pool: ProcessPoolExecutor, progress: _Progress, run: _Run) -> dict[str, Any]:
    """All measures: what the report is written from."""
    material = run.material
    portraits = {path: run.usable[path] for path in material.portraits if path in run.usable}
    work: dict[str, Future[Any]] = {}

    def submit(name: str, function: Callable[..., Any], *arguments: Any) -> None:
        work[name] = pool.submit(_timed, function, *arguments)

    # the longest work first, so that no core waits for it at the end
    nth = {clip: k for k, clip in enumerate(material.clips)}
    for clip in sorted(material.clips, key=lambda path: -path.stat().st_size):
        job = ClipJob(clip, *run.assets(clip), run.of_time(nth[clip]), portraits, run.frames, run.strips)
        submit(f"clip {clip.stem}", run_clip, job)
    for clip in material.clips:
        submit(f"truth {clip.stem}", run_truth, clip, run.assets(clip)[0], run.frames)
    ramped = [clip for clip in material.clips if clip.stem.startswith(_RAMP_CLIPS)] or list(material.clips[:1])
    for clip in ramped:
        for up in (True, False):
            name = f"ramp {clip.stem} {'up' if up else 'down'}"
            submit(name, run_ramp, clip, run.assets(clip)[0], run.strong, up, run.folder)
    scenes: list[tuple[Path, Path | None]] = [*material.labelled[1:3]] or [(material.portraits[0], None)]
    for portrait, labels in scenes:
        submit(f"leak {portrait.stem}", run_leak, portrait, labels, run.strong, run.folder)
    for media, labels_of_file in run.labels.items():
        submit(f"regions {media.stem}", run_regions, media, labels_of_file, *run.assets(media), run.strong)
    submit("masks", run_masks, material.labelled)
    done = progress.wait(work)

    def results(kind: str) -> list[Any]:
        return [done[name] for name in work if name.startswith(f"{kind} ")]

    return {
        "clips": sorted(results("clip"), key=lambda clip: str(clip["clip"])),
        "truth": results("truth"),
        "ramp": [row for rows in results("ramp") for row in rows],
        "leak": [row for rows in results("leak") for row in rows],
        "regions": [row for found in results("regions") for row in found["rows"]],
        "regions_left_out": [line for found in results("regions") for line in found["left_out"]],
        "masks": done["masks"],
    }


def _labels(folder: Path, material: Material) -> dict[Path, list[Label]]:
    """File -> its labels, of the chosen clips and of the portraits."""
    chosen = {path.name: path for path in (*material.clips, *material.portraits)}
    out: dict[Path, list[Label]] = {}
    for label in read_labels(folder):
        if label.media.name in chosen:
            out.setdefault(chosen[label.media.name], []).append(label)
    return out


def main() -> None:
    """Run everything and write the report."""
    options = _options()
    if find_spec("skimage") is None:
        sys.exit("scikit-image is not installed; `make bench-quality` installs it")
    material, frames = _chosen(options)
    start = time.perf_counter()
    strips: Path = options.out / "strips"
    strips.mkdir(parents=True, exist_ok=True)
    for old in strips.glob("*.jpg"):
        old.unlink()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    progress = _Progress()
    with tempfile.TemporaryDirectory() as name, ProcessPoolExecutor(options.workers) as pool:
        folder = Path(name)
        usable, failures = _prepare(pool, progress, material, folder)
        run = _Run(material, frames, _labels(options.labels, material), usable, folder, strips)
        results = _measure(pool, progress, run)
    results["about"] = {
        "source": material.source,
        "frames": frames,
        "references": [path.stem for path in material.references if path in usable],
        "portraits": [path.stem for path in material.portraits if path in usable],
        "unusable_portraits": [path.stem for path in material.portraits if path not in usable],
        "paper_failures": failures,
        "not_installed": missing(),
        "seconds": round(time.perf_counter() - start),
        "processor_s": round(progress.processor_s),
    }
    print("\n" + write_report(results, options.out))


if __name__ == "__main__":
    main()
