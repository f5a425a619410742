"""`python -m benchmarks.quality`: measure, compare, write the report; see ../README.md."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pvg
from benchmarks.quality.clips import ClipJob, run_clip, vectorize_clip
from benchmarks.quality.media import Material, choose, find_material
from benchmarks.quality.peers import missing
from benchmarks.quality.probes import run_leak, run_masks, run_reconstruction
from benchmarks.quality.report import write_report
from scripts.samples import REPOSITORY

OUT = REPOSITORY / "benchmarks" / "out" / "quality"
_QUICK_CLIPS = ("man_deep_brown", "man_tan_backlit", "woman_pale_redhair")
_LONG_CLIPS = ("woman_warm_light_head_turns", "man_deep_brown_skin_talking")


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.quality", description=__doc__)
    parser.add_argument("--clips", help="comma-separated parts of clip names; all when left out")
    parser.add_argument("--references", help="comma-separated parts of portrait names for the measures over time")
    parser.add_argument("--frames", type=int, help="frames of each clip that are measured (60; 24 with --quick)")
    parser.add_argument("--quick", action="store_true", help="3 clips, 2 references, 24 frames")
    parser.add_argument("--out", type=Path, default=OUT, help="folder of the report")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes")
    return parser.parse_args()


def _chosen(options: argparse.Namespace) -> tuple[Material, int]:
    """What to run on, and frames a clip."""
    material = find_material()
    clips = choose(material.clips, options.clips)
    references = choose(material.portraits, options.references) if options.references else material.references
    portraits, labelled = material.portraits, material.labelled
    if options.quick:
        quick = tuple(clip for clip in clips if clip.stem.startswith(_QUICK_CLIPS))
        clips = clips if options.clips else quick or clips
        references, portraits = references[:3:2], portraits[::4]
    frames = options.frames or (24 if options.quick else 60)
    return Material(clips, references, portraits, labelled, material.source), frames


def _vectorize_portrait(portrait: Path, asset: Path) -> str | None:
    """Write a reference's asset; returns why it cannot serve."""
    try:
        pvg.vectorize(portrait, asset=asset, reference=True).close()
    except pvg.PvgError as error:
        return str(error)
    return None


class _Progress:
    """One line a finished piece of work."""

    def __init__(self) -> None:
        self._start = time.perf_counter()

    def wait(self, work: dict[str, Future[Any]]) -> dict[str, Any]:
        """The results of named pieces of work, in order."""
        out = {}
        for name, future in work.items():
            out[name] = future.result()
            print(f"{time.perf_counter() - self._start:6.0f} s  {name}", flush=True)
        return out


def _prepare(
    pool: ProcessPoolExecutor, progress: _Progress, material: Material, folder: Path
) -> tuple[dict[Path, Path], dict[str, str]]:
    """Vectorise all portraits and clips into `folder`; returns portrait -> asset and clip -> the paper's failure."""
    portraits = {path: folder / f"{path.stem}.pvg" for path in {*material.references, *material.portraits}}
    work: dict[str, Future[Any]] = {}
    for path, asset in portraits.items():
        work[f"reference {path.stem}"] = pool.submit(_vectorize_portrait, path, asset)
    for clip in material.clips:
        for paper in (False, True):
            asset = folder / f"{clip.stem}{'.paper' * paper}.pvg"
            name = f"vectorise {clip.stem}{' as the paper' * paper}"
            work[name] = pool.submit(vectorize_clip, clip, asset, paper=paper)
    done = progress.wait(work)
    usable = {path: asset for path, asset in portraits.items() if done[f"reference {path.stem}"] is None}
    failures = {clip.stem: done[f"vectorise {clip.stem} as the paper"] for clip in material.clips}
    return usable, {name: why for name, why in failures.items() if why is not None}


def _measure(
    pool: ProcessPoolExecutor,
    progress: _Progress,
    material: Material,
    usable: dict[Path, Path],
    frames: int,
    folder: Path,
    strips: Path,
) -> dict[str, Any]:
    """All measures: what the report is written from."""
    references = {path: usable[path] for path in material.references if path in usable}
    portraits = {path: usable[path] for path in material.portraits if path in usable}
    work: dict[str, Future[Any]] = {}

    def submit(name: str, function: Callable[..., Any], *arguments: Any) -> None:
        work[name] = pool.submit(function, *arguments)

    for clip in material.clips:
        asset, paper = folder / f"{clip.stem}.pvg", folder / f"{clip.stem}.paper.pvg"
        submit(f"clip {clip.stem}", run_clip, ClipJob(clip, asset, paper, references, portraits, frames, strips))
    long = [clip for clip in material.clips if clip.stem.startswith(_LONG_CLIPS)] or list(material.clips[:1])
    for clip in long:
        submit(f"reconstruction {clip.stem}", run_reconstruction, clip, folder / f"{clip.stem}.pvg")
    scenes: list[tuple[Path, Path | None]] = [*material.labelled[1:3]] or [(material.portraits[0], None)]
    for portrait, labels in scenes:
        submit(f"leak {portrait.stem}", run_leak, portrait, labels, dict(list(references.items())[:3:2]), folder)
    submit("masks", run_masks, material.labelled)
    done = progress.wait(work)
    return {
        "clips": [done[name] for name in work if name.startswith("clip ")],
        "reconstruction": [done[name] for name in work if name.startswith("reconstruction ")],
        "leak": [row for name in work if name.startswith("leak ") for row in done[name]],
        "masks": done["masks"],
    }


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
        results = _measure(pool, progress, material, usable, frames, folder, strips)
    results["about"] = {
        "source": material.source,
        "frames": frames,
        "references": [path.stem for path in material.references if path in usable],
        "portraits": [path.stem for path in material.portraits if path in usable],
        "unusable_portraits": [path.stem for path in material.portraits if path not in usable],
        "paper_failures": failures,
        "not_installed": missing(),
        "seconds": round(time.perf_counter() - start),
    }
    print("\n" + write_report(results, options.out))


if __name__ == "__main__":
    main()
