"""The client's own distribution in an empty environment: it brings httpx alone and speaks to the service."""

from __future__ import annotations

import json
import sys
import zipfile
from pathlib import Path

import pytest

import pvg_client
from tests.install.environments import REPOSITORY, Environment, bare_environment, build, run, succeeds
from tests.service.servers import free_port

_SOURCES = ("src", "pyproject.toml", "README.md", "LICENSE")
pytestmark = pytest.mark.timeout(600)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("dist"), REPOSITORY / "client", _SOURCES)[0]


@pytest.fixture(scope="module")
def alone(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Environment:
    made = bare_environment(tmp_path_factory.mktemp("alone") / "environment", Path(sys.executable).resolve())
    made.install(wheel)
    return made


def test_the_wheel_holds_the_client_and_its_types(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as opened:
        names = opened.namelist()
    assert {"pvg_client/__init__.py", "pvg_client/py.typed"} <= set(names)
    assert any(name.endswith("licenses/LICENSE") for name in names)
    assert {name.split("/")[0].split("-")[0] for name in names} == {"pvg_client"}
    assert pvg_client.__version__ in wheel.name


def test_it_needs_httpx_alone(alone: Environment) -> None:
    script = "import importlib.metadata as m, json; print(json.dumps([d.name for d in m.distributions()]))"
    there = {name.lower() for name in json.loads(succeeds(alone.python, "-c", script))}
    assert there - {"anyio", "certifi", "h11", "httpcore", "idna", "sniffio", "typing_extensions"} == {
        "httpx",
        "pvg-client",
    }
    for name in ("pvg", "service", "tqdm"):
        assert run(alone.python, "-c", f"import {name}").returncode != 0


def test_it_works_there(alone: Environment) -> None:
    script = f"import pvg_client; pvg_client.Client('http://127.0.0.1:{free_port()}', retries=0).job('job_1')"
    done = run(alone.python, "-W", "error", "-c", script)
    assert done.stderr.splitlines()[-1].startswith("pvg_client.errors.UnreachableError: GET http://127.0.0.1:")
