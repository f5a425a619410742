"""The source distribution without pins, as who installs it today gets it."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from scripts.samples import Samples
from tests.gallery.clips import cut_clip
from tests.install.environments import Environment, build, pythons, recolour, run, succeeds


@pytest.mark.timeout(1800)  # downloads and compilers
def test_the_newest_of_everything_made_by_uv(samples: Samples, tmp_path: Path) -> None:
    """The newest Python of this machine, and an environment without pip."""
    _, sdist = build(tmp_path)
    python = pythons()[0]
    tools = Environment(tmp_path / "tools")
    succeeds(sys.executable, "-m", "venv", tools.folder)
    tools.install("uv")
    uv, made = tools.command("uv"), Environment(tmp_path / "newest")
    succeeds(uv, "venv", "--quiet", "--python", python, made.folder)
    succeeds(uv, "pip", "install", "--quiet", "--python", made.python, sdist)
    assert run(made.python, "-m", "pip", "--version").returncode != 0
    variables = {"PVG_CACHE_DIR": str(tmp_path / "cache"), "PATH": f"{uv.parent}:{os.environ['PATH']}"}
    assert "installed in" in succeeds(made.command("pvg"), "models", **variables)
    clip = cut_clip(samples.woman_clip, tmp_path / "clip.mp4", 20, 26)
    recolour(made, clip, samples.dark_portrait, tmp_path, **variables)
    print(succeeds(made.python, "-VV"), succeeds(uv, "pip", "list", "--python", made.python))
