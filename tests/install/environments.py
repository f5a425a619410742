"""Environments of their own, made by pip and by uv, and the built distributions to put into them."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pvg.video import probe

REPOSITORY = Path(__file__).resolve().parents[2]
CONSTRAINTS = REPOSITORY / "constraints.txt"
_SOURCES = ("pvg", "service", "worker", "pyproject.toml", "pvg_service.py", "README.md", "LICENSE", "NOTICE")


def environment(**variables: str) -> dict[str, str]:
    """The variables of a user who knows nothing of this repository."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PVG_", "PYTHON", "NUMBA_", "VIRTUAL_ENV"))}
    return kept | variables


def run(*command: str | Path, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run from the root folder, where nothing of ours is on any path."""
    return subprocess.run(
        [str(part) for part in command],
        env=environment(**variables),
        cwd="/",
        capture_output=True,
        text=True,
        timeout=1200,
        check=False,
    )


def succeeds(*command: str | Path, **variables: str) -> str:
    """What it printed. Fails the test when it fails."""
    done = run(*command, **variables)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@dataclass(frozen=True)
class Environment:
    """An environment in a folder."""

    folder: Path

    def command(self, name: str) -> Path:
        """One of its programs."""
        return self.folder / "bin" / name

    @property
    def python(self) -> Path:
        """Its interpreter."""
        return self.command("python")

    def install(self, *requirements: str | Path) -> None:
        """With the pip that runs the tests: this environment has none."""
        pip = [
            sys.executable,
            "-m",
            "pip",
            "--python",
            self.python,
            "install",
            "--quiet",
            "--disable-pip-version-check",
        ]
        succeeds(*pip, *requirements)


def bare_environment(folder: Path, python: str | Path) -> Environment:
    """An empty environment without pip."""
    succeeds(python, "-m", "venv", "--without-pip", folder)
    return Environment(folder)


def build(folder: Path, root: Path = REPOSITORY, sources: Sequence[str] = _SOURCES) -> tuple[Path, Path]:
    """The wheel and the source distribution; the wheel is built from the latter, which therefore is complete."""
    copy = folder / "source"
    copy.mkdir()
    for name in sources:
        path = root / name
        if path.is_dir():
            shutil.copytree(path, copy / name, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
        else:
            shutil.copy(path, copy)
    script = "import sys, setuptools.build_meta as backend; print(backend.build_sdist(sys.argv[1]))"
    done = subprocess.run(
        [sys.executable, "-c", script, str(folder)], cwd=copy, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    (sdist,) = folder.glob("*.tar.gz")
    options = ["--quiet", "--disable-pip-version-check", "--no-deps", "--no-build-isolation"]
    succeeds(sys.executable, "-m", "pip", "wheel", *options, "--wheel-dir", folder, sdist)
    (wheel,) = folder.glob("*.whl")
    return wheel, sdist


def recolour(tools: Environment, clip: Path, portrait: Path, folder: Path, **variables: str) -> None:
    """Vectorise, transfer and look at a clip with the command, from the shell."""
    asset, out = folder / "clip.pvg", folder / "out.mp4"
    succeeds(tools.command("pvg"), "vectorize", clip, "-o", asset, **variables)
    succeeds(tools.command("pvg"), "transfer", asset, "--reference", portrait, "-o", out, **variables)
    assert probe(out).frame_count == 6
    summary = json.loads(succeeds(tools.command("pvg"), "inspect", asset, **variables))
    assert len(summary["faces"]) == 1


def pythons() -> list[Path]:
    """The interpreters of this machine from 3.11 on, the newest first."""
    names = [f"python3.{minor}" for minor in range(11, 20)]
    found = [Path(path) for name in names if (path := shutil.which(name))]
    found += [path for name in names for path in Path.home().glob(f".pyenv/versions/*/bin/{name}")]
    found.append(Path(sys.executable).resolve())
    script = "import sys; print(*sys.version_info[:3]) if sys.version_info.releaselevel == 'final' else sys.exit(1)"
    versions: dict[tuple[int, ...], Path] = {}
    for path in found:
        done = run(path, "-c", script)
        if done.returncode == 0:
            versions[tuple(map(int, done.stdout.split()))] = path
    return [versions[version] for version in sorted(versions, reverse=True)]
