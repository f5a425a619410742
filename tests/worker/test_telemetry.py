from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from service.processes import worker_environment
from service.settings import Settings


def test_the_worker_leaves_no_device_id_and_no_events_of_onnxruntime(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("CI", "ORT_DISABLE_TELEMETRY", "ORT_RUNNING_UNIT_TESTS"):  # each switches it off as well
        monkeypatch.delenv(name, raising=False)
    home = {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    environment = worker_environment(Settings(data_dir=tmp_path / "data")) | home
    subprocess.run([sys.executable, "-c", "import onnxruntime"], env=environment, check=True, timeout=60)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
