"""The cache folder of converted networks: where it is, and what in it may be trusted."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pvg._folders import cache_root
from pvg.errors import ModelError
from pvg.models.networks import MODELS, ModelFile, OwnFile

__all__ = ["CONVERTER_VERSION", "cache_folder", "check", "own", "sha256", "store", "verified"]

CONVERTER_VERSION = 2
"""Raised whenever the converter's output changes, so that an old cache is left alone and a new one is made."""

_REMEDY = "run `pvg models` (`make setup` in the repository)"


def cache_folder() -> Path:
    """Folder of the converted networks: `models-<converter version>` under $PVG_CACHE_DIR or ~/.cache/pvg.

    Raises ModelError for a user without a home folder where PVG_CACHE_DIR is not set.
    """
    root = cache_root()
    if root is None:
        raise ModelError("this user has no home folder for the network weights; set PVG_CACHE_DIR to where they are")
    return root / f"models-{CONVERTER_VERSION}"


def sha256(data: bytes) -> str:
    """The SHA-256 of the bytes, in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def verified(model: ModelFile) -> bytes:
    """Bytes of one converted network. Raises ModelError, saying what to run, when it is missing or altered."""
    folder = cache_folder()
    path = folder / f"{model.name}.onnx"
    try:
        manifest: dict[str, Any] = json.loads((folder / "manifest.json").read_text())
        data = path.read_bytes()
        expected = manifest["models"][model.name]
        source_sha256, onnx_sha256 = expected["tflite_sha256"], expected["onnx_sha256"]
    except FileNotFoundError as error:
        raise ModelError(f"the weights {model.name} are not installed in {folder}; {_REMEDY}") from error
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ModelError(f"the weights {model.name} in {folder} are unreadable; {_REMEDY}") from error
    is_cut_there = expected.get("outputs", []) == list(model.outputs)
    if source_sha256 != model.tflite_sha256 or onnx_sha256 != sha256(data) or not is_cut_there:
        raise ModelError(f"the weights {path} are not the pinned ones (sha256 differs); {_REMEDY}")
    return data


def own(model: OwnFile) -> bytes:
    """Bytes of a network that comes with this package. Raises ModelError when it is missing or altered."""
    path = Path(__file__).with_name(model.file)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ModelError(f"{path} is missing or unreadable; install pvg-face-color again") from error
    if sha256(data) != model.sha256:
        raise ModelError(f"{path} is not the one that belongs here (sha256 differs); install pvg-face-color again")
    return data


def check() -> None:
    """Return when all networks of MODELS are there; raise ModelError, as `verified` does, for the first that is not."""
    for model in MODELS.values():
        verified(model)


def store(converted: Mapping[str, bytes]) -> None:
    """Write all networks of MODELS, by name, into the cache folder. Raises ModelError where it cannot be written."""
    folder = cache_folder()
    manifest: dict[str, Any] = {"converter_version": CONVERTER_VERSION, "models": {}}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, data in converted.items():
            _write_atomically(folder / f"{name}.onnx", data)
            manifest["models"][name] = {
                "tflite_sha256": MODELS[name].tflite_sha256,
                "onnx_sha256": sha256(data),
                "package": MODELS[name].package.requirement,
                "outputs": list(MODELS[name].outputs),
            }
        # last, so that a crash before it leaves a folder that is refused and made anew
        _write_atomically(folder / "manifest.json", json.dumps(manifest, indent=2).encode())
    except OSError as error:
        raise ModelError(
            f"{folder} cannot be written ({error.strerror}); set PVG_CACHE_DIR to another folder"
        ) from error


def _write_atomically(path: Path, data: bytes) -> None:
    handle, temporary = tempfile.mkstemp(prefix=f".{path.name}-", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        # mkstemp makes it private; a cache baked into an image is read by another user
        Path(temporary).chmod(0o644)
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
