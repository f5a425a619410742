"""Speed: targets, stages, whole runs, peers and growth in one run; see README.md."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.clips import find_clip
from benchmarks.plots import draw_plots
from benchmarks.report import tables
from benchmarks.suite import FULL, QUICK, SECTIONS, Suite
from benchmarks.targets import target_rows
from benchmarks.timing import machine_facts
from pvg.video import probe
from pvg.warmup import warm_up
from scripts.samples import REPOSITORY

OUT = REPOSITORY / "benchmarks" / "out"


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("clip", nargs="?", type=Path, help="another clip than the 1080p one")
    parser.add_argument("--quick", action="store_true", help="about two minutes: fewer frames, rounds and sizes")
    parser.add_argument("--only", default="", help=f"comma-separated sections of {', '.join(SECTIONS)}")
    parser.add_argument("--out", type=Path, default=OUT, help="folder for the JSON, the tables and the plots")
    return parser.parse_args()


def main() -> None:
    """Measure, print the tables and write them with JSON and plots."""
    options = _arguments()
    only = tuple(filter(None, options.only.split(",")))
    if unknown := set(only) - set(SECTIONS):
        sys.exit(f"no section {unknown.pop()!r}; there are {', '.join(SECTIONS)}")
    started, facts = time.perf_counter(), machine_facts()
    options.out.mkdir(parents=True, exist_ok=True)
    warm_up()
    with tempfile.TemporaryDirectory(prefix="pvg-bench-") as folder:
        material = find_clip(options.clip, Path(folder))
        info = probe(material.clip)
        clip = f"{material.clip.name}: {info.width}x{info.height}, {info.frame_count} frames ({material.source})"
        print(f"{clip}; {facts['cores']} cores, {facts['cpu']}, load {facts['load'][0]}", flush=True)
        suite = Suite(material, QUICK if options.quick else FULL, Path(folder))
        suite.run(only)
    rows = target_rows(suite.results)
    suite.results["targets"] = [row.to_json() for row in rows]
    text = tables(suite.results, rows)
    took = time.perf_counter() - started
    print(f"\n{text}\n\n{took:.0f} s in all; load now {machine_facts()['load'][0]}")
    mode = "quick" if options.quick else "full"
    report = {"mode": mode, "clip": clip, "machine": facts, "seconds": took, **suite.results}
    (options.out / "bench.json").write_text(json.dumps(report, indent=1))
    (options.out / "bench.txt").write_text(f"{clip}\n{json.dumps(facts)}\n\n{text}\n")
    drawn = draw_plots(suite.results, options.out)
    print(f"{options.out}: bench.json, bench.txt, {', '.join(drawn)}")


if __name__ == "__main__":
    main()
