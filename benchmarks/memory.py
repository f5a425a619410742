"""`python -m benchmarks.memory`: memory that clips of several sizes and kinds take, beside what is said of them.

A face's clip is coded anew in each kind, vectorised and rendered with one look and with three, each in a process of
its own. Measured is its data (VmData, what a limit counts) at the peak, sampled each 10 ms; `pvg.memory` says what is
refused before it starts, so it must not say less, and little more.
"""

from __future__ import annotations

import argparse
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import av

import pvg
from benchmarks.alone import run_alone
from benchmarks.clips import there_and_back
from pvg.memory import rendering_bytes, vectorizing_bytes
from pvg.video import probe
from scripts.samples import fetch_samples

_MB = 1e6
_APART_S = 0.01  # between two samples


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.memory", description=__doc__)
    parser.add_argument("--sizes", default="640x360,1920x1080,3840x2160", help="comma-separated")
    parser.add_argument("--formats", default="yuv420p,yuv420p10le,yuv444p,yuv444p10le", help="comma-separated")
    parser.add_argument("--frames", type=int, default=60)
    return parser.parse_args()


def _clip(target: Path, source: Path, size: tuple[int, int], pixel_format: str, count: int) -> Path:
    """The source's frames there and back, scaled, in a format; coded with HEVC, nearly without loss of time."""
    with av.open(str(target), "w") as output:
        stream: Any = output.add_stream(
            "libx265", rate=25, options={"preset": "ultrafast", "x265-params": "log-level=0"}
        )
        stream.width, stream.height, stream.pix_fmt = *size, pixel_format
        for frame in islice(there_and_back(source, count), count):
            picture = av.VideoFrame.from_ndarray(frame.rgb(), format="rgb24")
            output.mux(stream.encode(picture.reformat(*size, format=pixel_format)))
        output.mux(stream.encode())
    return target


@contextmanager
def _peak() -> Iterator[Callable[[], float]]:
    """What to ask afterwards for the most MB of data that this process had meanwhile."""
    ended, most = threading.Event(), 0

    def sample() -> None:
        nonlocal most
        while not ended.wait(_APART_S):
            most = max(most, _data_bytes())

    sampler = threading.Thread(target=sample)
    sampler.start()
    try:
        yield lambda: most / _MB
    finally:
        ended.set()
        sampler.join()


def _data_bytes() -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmData:"):
            return 1024 * int(line.split()[1])
    raise RuntimeError("no VmData: this is measured on Linux")


def vectorize_clip(clip: str, asset: str) -> float:
    """MB of data at the peak."""
    with _peak() as most:
        pvg.vectorize(clip, asset=asset).close()
    return most()


def render_looks(clip: str, asset: str, reference: str, folder: str, looks: int) -> float:
    """The same, of so many looks in one pass."""
    with _peak() as most, pvg.open_asset(asset, clip) as video, pvg.open_asset(reference) as colors:
        all_of_them = [pvg.transfer(video, colors, seed=k) for k in range(looks)]
        paths = [Path(folder) / f"{k}.mp4" for k in range(looks)]
        pvg.render(video, all_of_them, paths, memory_bytes=2**40)
    return most()


def main() -> None:
    """Measure and print a table."""
    options = _options()
    samples = fetch_samples()
    print("| size | samples | vectorising | one look | three looks |\n|---|---|---|---|---|", flush=True)
    with tempfile.TemporaryDirectory(prefix="pvg-memory-") as name:
        folder = Path(name)
        reference = folder / "reference.pvg"
        pvg.vectorize(samples.portrait, reference=True, asset=reference).close()
        for size in options.sizes.split(","):
            for pixel_format in options.formats.split(","):
                width, height = map(int, size.split("x"))
                clip = _clip(folder / "clip.mp4", samples.woman_clip, (width, height), pixel_format, options.frames)
                media, asset = probe(clip), folder / "clip.pvg"
                taken = [run_alone(vectorize_clip, clip, asset).result]
                taken += [run_alone(render_looks, clip, asset, reference, folder, n).result for n in (1, 3)]
                said = [vectorizing_bytes(media), rendering_bytes(media, 1), rendering_bytes(media, 3)]
                cells = (f"{mb:.0f} ({most / _MB:.0f})" for mb, most in zip(taken, said, strict=True))
                print(f"| {size} | {pixel_format} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
