"""`python -m pvg.warmup` compiles all that a transfer needs: afterwards nobody waits for the compiler."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from pvg.video import Frame, MediaInfo, PixelFormat, VideoWriter, probe, read_frames, read_image, write_image
from scripts.samples import Samples

SEEN = """
import atexit, gc, sys
from numba.core import event
from numba.core.dispatcher import Dispatcher

class Listener(event.Listener):
    def on_start(self, event):
        print("compiled", event.data["dispatcher"].py_func.__qualname__)
    def on_end(self, event):
        pass

def list_kernels():
    for kernel in gc.get_objects():
        if isinstance(kernel, Dispatcher) and kernel.py_func.__module__.startswith("pvg."):
            for types in kernel.signatures:
                print("used", kernel.py_func.__module__, kernel.py_func.__qualname__, types)

event.register("numba:compile", Listener())
atexit.register(list_kernels)
"""
WARM_UP = "from pvg.warmup import warm_up; warm_up()"
TRANSFERS = """
import sys, pvg

folder = sys.argv[1]
still, clip, two, deep = (f"{folder}/{name}" for name in ("still.png", "clip.mp4", "two.mp4", "deep.mp4"))
with pvg.vectorize(still, reference=True) as portrait, pvg.vectorize(clip, reference=True) as moving:
    for source, settings in (
        (clip, {}), (clip, {"matching": "chain", "mask": "ycbcr"}), (two, {}), (deep, {}), (still, {})
    ):
        with pvg.vectorize(source, **settings) as video:
            assert len(video.faces) == (2 if source == two else 1), source
            looks = [
                pvg.transfer(video, portrait),
                pvg.transfer(video, moving, contrast=1.1, match="color", strength=0.5),
            ]
            kind = "png" if source == still else "mp4"
            pvg.render(video, looks, [f"{folder}/look-{k}.{kind}" for k in range(2)])
            for name in ("curves", "low", "high"):
                pvg.layer(video, 0, name)
"""


@dataclass(frozen=True)
class Kernels:
    """What a process did.  compiled: names;  used: compiled functions with the types of their arguments."""

    compiled: set[str]
    used: set[str]


def kernels(script: str, *arguments: str, **variables: str) -> Kernels:
    done = subprocess.run(
        [sys.executable, "-c", SEEN + script, *arguments],
        env=os.environ | variables,
        capture_output=True,
        text=True,
        timeout=500,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    lines = [line.split(" ", 1) for line in done.stdout.splitlines()]
    return Kernels(*({what for kind, what in lines if kind == wanted} for wanted in ("compiled", "used")))


def _write(path: Path, source: MediaInfo, planes: list[Frame]) -> None:
    first = planes[0]
    info = MediaInfo(**{**vars(source), "width": first.width, "height": first.height, "has_audio": False})
    with VideoWriter(path, info, first.format) as writer:
        for frame in planes:
            writer.write(frame)


@pytest.fixture(scope="module")
def inputs(samples: Samples, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A still, a clip, the same in 10 bits, and the same twice side by side; 3 frames each."""
    folder = tmp_path_factory.mktemp("inputs")
    write_image(folder / "still.png", read_image(samples.pale_portrait).rgb()[::2, ::2])
    info = probe(samples.woman_clip)
    frames = list(read_frames(samples.woman_clip, start=20, stop=23))
    _write(folder / "clip.mp4", info, frames)
    deep = PixelFormat("yuv420p10le", 10, (1, 1), frames[0].format.luma_weights, frames[0].format.full_range)

    def to_10_bits(frame: Frame) -> Frame:
        a, b, c = (plane.astype(np.uint16) << 2 for plane in frame.planes)
        return Frame(frame.index, frame.pts, frame.time_s, deep, (a, b, c), frame.duration)

    def doubled(frame: Frame) -> Frame:
        a, b, c = (np.hstack([plane, plane[:, ::-1]]) for plane in frame.planes)
        return Frame(frame.index, frame.pts, frame.time_s, frame.format, (a, b, c), frame.duration)

    _write(folder / "deep.mp4", info, [to_10_bits(frame) for frame in frames])
    _write(folder / "two.mp4", info, [doubled(frame) for frame in frames])
    return folder


def test_after_warming_up_no_transfer_compiles_anything(inputs: Path) -> None:
    """What an earlier process compiled besides lies in the same cache, so the types of the calls are compared too."""
    warm = kernels(WARM_UP)
    transfers = kernels(TRANSFERS, str(inputs))
    assert len(transfers.used) > 20
    assert transfers.used - warm.used == set()
    assert transfers.compiled == set()


def test_two_processes_compile_all_of_it_between_them() -> None:
    halves = ("_render()", "_solve(); warmup._follow_and_show()")
    done = [kernels(f"from pvg import warmup; warmup.{half}").used for half in halves]
    assert min(map(len, done)) > 20
    assert done[0] | done[1] == kernels(WARM_UP).used


def test_compiling_would_be_seen(tmp_path: Path) -> None:
    script = "import numpy as np; from pvg.face import FaceAxes; FaceAxes.of(np.zeros((106, 2)))"
    seen = kernels(script, NUMBA_CACHE_DIR=str(tmp_path))
    assert seen.compiled
    assert seen.used
    assert list(tmp_path.rglob("*.nbc"))
