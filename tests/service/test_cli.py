from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from service.cli import cli
from service.settings import Settings


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5", "example.com", ""])
def test_any_other_address_is_refused_without_keys(host: str, tmp_path: Path) -> None:
    assert not Settings(host=host).listens_to_loopback_only
    environment = {"PVG_HOST": host, "PVG_DATA_DIR": str(tmp_path / "data")}
    result = CliRunner().invoke(cli, ["serve"], env=environment)
    assert result.exit_code == 2
    assert "PVG_ALLOW_UNAUTHENTICATED_NETWORK" in result.output
    assert not (tmp_path / "data").exists()


def test_a_bad_setting_is_one_line_that_names_it() -> None:
    result = CliRunner().invoke(cli, ["serve"], env={"PVG_MAX_UPLOAD_BYTES": "lots"})
    assert result.exit_code == 2
    assert result.output.count("\n") == 1
    assert "PVG_MAX_UPLOAD_BYTES" in result.output


@pytest.mark.parametrize(
    ("arguments", "setting", "code", "words"),
    [
        (["serve"], {"PVG_LEASE_S": "5"}, 2, "lease_s must be at least twice"),
        (["migrate"], {"PVG_DATABASE_URL": "nonsense"}, 2, "PVG_DATABASE_URL"),
        (["migrate"], {"PVG_DATABASE_URL": "postgresql://u:secret@127.0.0.1:1/d"}, 1, "database"),
        (["gc"], {}, 2, "pvg-service migrate"),
        (["migrate"], {"PVG_DATA_DIR": "/dev/null/data"}, 1, "/dev/null/data"),
    ],
)
def test_what_it_cannot_start_with_is_one_line(
    arguments: list[str], setting: dict[str, str], code: int, words: str, tmp_path: Path
) -> None:
    command = [str(Path(sys.executable).with_name("pvg-service")), *arguments]
    environment = os.environ | {"PVG_DATA_DIR": str(tmp_path / "data")} | setting
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == code
    assert result.stderr.count("\n") == 1
    assert words in result.stderr
    assert "secret" not in result.stderr


def test_the_service_starts_without_the_method_and_the_worker() -> None:
    code = "import sys, service.api.app, service.cli; print(sorted(m.split('.')[0] for m in sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    modules = set(ast.literal_eval(loaded))
    assert "fastapi" in modules
    assert not modules & {"pvg", "worker", "cv2", "numpy", "onnxruntime", "av", "numba"}
