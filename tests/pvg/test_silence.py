"""Nothing leaves the machine and nothing is left on it: seen from outside the process."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pvg.models import cache_folder
from scripts.samples import Samples
from tests.service.servers import installed

# what keeps onnxruntime silent in itself; a user's machine has none of it
_SILENCING = ("CI", "GITHUB_ACTIONS", "TF_BUILD", "ORT_DISABLE_TELEMETRY", "ORT_RUNNING_UNIT_TESTS")


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """An empty home folder but for the network weights."""
    folder = tmp_path / "home"
    shutil.copytree(cache_folder(), folder / ".cache" / "pvg" / cache_folder().name)
    return folder


def environment(home: Path) -> dict[str, str]:
    kept = {k: v for k, v in os.environ.items() if k not in (*_SILENCING, "PVG_CACHE_DIR") and not k.startswith("XDG_")}
    return kept | {"HOME": str(home)}


def traced(log: Path, command: list[str], home: Path) -> list[str]:
    """The addresses and look-ups that a process and its threads tried: lines of strace that name the Internet."""
    done = subprocess.run(
        [installed("strace"), "-f", "-qq", "-e", "trace=%network", "-o", str(log), *command],
        env=environment(home),
        capture_output=True,
        text=True,
        timeout=550,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return [line for line in log.read_text().splitlines() if re.search(r"AF_INET6?\b|AF_NETLINK|port=", line)]


def test_vectorising_and_rendering_look_nothing_up_and_call_nobody(
    home: Path, samples: Samples, tmp_path: Path
) -> None:
    # onnxruntime sends its first report by a thread, more than 4 s after the networks are loaded
    script = """
import sys, time, pvg
with pvg.vectorize(sys.argv[1], asset=sys.argv[4]) as video, pvg.vectorize(sys.argv[2]) as reference:
    pvg.render(video, [pvg.transfer(video, reference)], [sys.argv[3]])
time.sleep(12)
"""
    out, asset = tmp_path / "out.png", tmp_path / "portrait.pvg"
    paths = [str(samples.portrait), str(samples.dark_portrait), str(out), str(asset)]
    assert traced(tmp_path / "log", [sys.executable, "-c", script, *paths], home) == []
    assert out.exists()
    assert asset.exists()
    assert left_behind(home) == []


def left_behind(home: Path) -> list[Path]:
    """Files in a home folder that are not this library's."""
    return [path for path in home.rglob("*") if path.is_file() and not path.is_relative_to(home / ".cache" / "pvg")]


def test_the_trace_would_show_a_call(home: Path, tmp_path: Path) -> None:
    script = "import socket; s = socket.socket(); s.settimeout(1); s.connect_ex(('127.0.0.1', 9))"
    assert traced(tmp_path / "log", [sys.executable, "-c", script], home)


def test_onnxruntime_is_imported_in_one_place_only() -> None:
    repository = Path(__file__).resolve().parents[2]
    folders = ("pvg", "service", "worker", "scripts", "benchmarks", "tests")
    importing = [
        path.relative_to(repository).as_posix()
        for folder in folders
        for path in (repository / folder).rglob("*.py")
        if re.search(r"^\s*(import|from) onnxruntime\b", path.read_text(), re.MULTILINE)
    ]
    assert importing == ["pvg/models/sessions.py"]
