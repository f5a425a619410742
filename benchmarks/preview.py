"""Seconds that single pictures take over HTTP: `python -m benchmarks.preview [CLIP …]`.

The service runs on its embedded default. For each clip: the first preview after it is ready, 30 of a slider that is
moved (strength, contrast, make-up, light in turns), the same with renders under way, another frame each time, and the
same picture again.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx

from benchmarks.service_run import served, until_done, upload
from benchmarks.timing import machine_facts
from scripts.samples import fetch_samples

_PICTURES = 30
_WAIT_S = 60.0


def _ready(client: httpx.Client, path: str, file: Path) -> dict[str, Any]:
    medium = upload(client, path, file)
    until_done(client, medium["job"])
    body: dict[str, Any] = client.get(f"{path}/{medium['id']}").raise_for_status().json()
    return body


def _timed(client: httpx.Client, body: dict[str, Any]) -> float:
    began = time.perf_counter()
    client.post("/preview", json=body).raise_for_status()
    return time.perf_counter() - began


def _await_worker(client: httpx.Client, body: dict[str, Any]) -> None:
    """Until the worker of previews has started; of another medium than the one measured."""
    until = time.monotonic() + _WAIT_S
    while client.post("/preview", json=body).status_code == httpx.codes.SERVICE_UNAVAILABLE:
        if time.monotonic() > until:
            raise RuntimeError("no worker makes pictures")
        time.sleep(0.2)


def _moves(base: dict[str, Any], seed: int) -> Iterator[dict[str, Any]]:
    """A slider that is moved: one option after the other."""
    for turn in range(_PICTURES):
        share = (turn + 1) / (_PICTURES + 1)
        option = ({"strength": share}, {"contrast": 0.7 + 0.8 * share}, {"makeup": share}, {"light": share})[turn % 4]
        yield {**base, "look": {**base["look"], **option, "seed": seed}}


def _summary(seconds: list[float]) -> str:
    ordered = sorted(seconds)
    late = ordered[min(len(ordered) - 1, round(0.95 * (len(ordered) - 1)))]
    return f"p50 {statistics.median(ordered):.3f} s, p95 {late:.3f} s, longest {ordered[-1]:.3f} s"


def measure(client: httpx.Client, clip: Path, reference: str, say: Callable[[str], None]) -> dict[str, list[float]]:
    """Seconds of each kind of preview of a clip."""
    video = _ready(client, "/videos", clip)
    media = video["media"]
    say(f"{clip.name}: {media['width']}x{media['height']}, {media['frame_count']} frames")
    base = {"video": video["id"], "look": {"reference": reference}}
    found = {"first": [_timed(client, base)]}
    found["slider"] = [_timed(client, body) for body in _moves(base, 0)]
    *_, last_move = _moves(base, 0)
    found["same again"] = [_timed(client, last_move) for _ in range(_PICTURES // 3)]
    last = media["frame_count"] - 1
    frames = [last * turn // (_PICTURES - 1) for turn in range(_PICTURES)]
    found["other frame, nearest"] = [_timed(client, {**base, "frame": frame, "nearest": True}) for frame in frames]
    found["other frame, exact"] = [_timed(client, {**base, "frame": frame}) for frame in frames[::3]]
    looks = [{"reference": reference, "seed": seed} for seed in range(8)]
    jobs = [
        client.post("/transfer", json={"video": video["id"], "looks": looks, "force": True}).raise_for_status().json()
        for _ in range(2)
    ]
    time.sleep(2)
    found["slider during renders"] = [_timed(client, body) for body in _moves(base, 1)]
    for job in jobs:
        client.post(f"/jobs/{job['id']}/cancel")
    for name, seconds in found.items():
        say(f"  {name}: {_summary(seconds)}")
    return found


def main() -> None:
    """Measure and print; with --out, write the seconds as JSON."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.preview", description=__doc__)
    parser.add_argument("clips", nargs="*", type=Path, help="clips to measure; the sample of 640x360 without any")
    parser.add_argument("--out", type=Path, help="file for the seconds")
    options = parser.parse_args()
    samples = fetch_samples()
    facts = machine_facts()
    print(f"{facts['cores']} cores, {facts['cpu']}, load {facts['load'][0]}", flush=True)
    results = {}
    with tempfile.TemporaryDirectory() as folder, served(Path(folder)) as client:
        reference = _ready(client, "/references", samples.dark_portrait)["id"]
        other = _ready(client, "/videos", samples.pale_portrait)["id"]
        _await_worker(client, {"video": other, "look": {"reference": reference}})
        for clip in options.clips or [samples.woman_clip]:
            results[clip.name] = measure(client, clip, reference, lambda line: print(line, flush=True))
    print(f"load now {machine_facts()['load'][0]}")
    if options.out:
        options.out.write_text(json.dumps({"machine": facts, "seconds": results}, indent=1))


if __name__ == "__main__":
    main()
