"""`python -m pvg.warmup` compiles all that a transfer needs: afterwards nobody waits for the compiler."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pvg.video import Frame, MediaInfo, PixelFormat, VideoWriter, probe, read_frames, read_image, write_image
from scripts.samples import Samples

COMPILED = """
import sys
from numba.core import event

names = []

class Listener(event.Listener):
    def on_start(self, event):
        names.append(event.data["dispatcher"].py_func.__qualname__)
    def on_end(self, event):
        pass

event.register("numba:compile", Listener())
"""
TRANSFERS = """
import pvg

folder = sys.argv[1]
still, clip, two, deep = (f"{folder}/{name}" for name in ("still.png", "clip.mp4", "two.mp4", "deep.mp4"))
with pvg.vectorize(still, reference=True) as portrait, pvg.vectorize(clip, reference=True) as moving:
    for source, settings in (
        (clip, {}), (clip, {"matching": "chain"}), (clip, {"mask": "ycbcr"}), (two, {}), (deep, {}), (still, {})
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
print(*sorted(set(names)))
"""


def run(cache: Path, *arguments: str) -> str:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    done = subprocess.run(
        [sys.executable, *arguments], env=environment, capture_output=True, text=True, timeout=500, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def machine_code(cache: Path) -> set[Path]:
    return {path.relative_to(cache) for path in cache.rglob("*.nbc")}


def _write(path: Path, source: MediaInfo, planes: list[Frame]) -> None:
    first = planes[0]
    info = MediaInfo(**{**vars(source), "width": first.width, "height": first.height, "has_audio": False})
    with VideoWriter(path, info, first.format) as writer:
        for frame in planes:
            writer.write(frame)


@pytest.fixture(scope="module")
def inputs(samples: Samples, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A still, a clip, the same in 10 bits, and the same twice side by side; 6 frames each."""
    folder = tmp_path_factory.mktemp("inputs")
    write_image(folder / "still.png", read_image(samples.pale_portrait).rgb())
    info = probe(samples.woman_clip)
    frames = list(read_frames(samples.woman_clip, start=20, stop=26))
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


def test_after_warming_up_no_transfer_compiles_anything(inputs: Path, tmp_path: Path) -> None:
    run(tmp_path, "-m", "pvg.warmup")
    warm = machine_code(tmp_path)
    assert run(tmp_path, "-c", COMPILED + TRANSFERS, str(inputs)).split() == []
    assert machine_code(tmp_path) == warm


def test_compiling_would_be_seen(tmp_path: Path) -> None:
    script = "import numpy as np; from pvg.rendering import _kernels; print(*names)"
    assert run(tmp_path, "-c", COMPILED + script)
    assert machine_code(tmp_path)
