"""What a run says in its last lines where servers are not installed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.service.servers import PACKAGES, missing

REPOSITORY = Path(__file__).resolve().parents[1]

TINY = """
from tests.service.servers import postgres_server, redis_server

def test_redis(tmp_path):
    with redis_server(tmp_path):
        pass

def test_redis_again(redis_url):
    pass

def test_postgres():
    with postgres_server():
        pass

def test_without():
    pass
"""


@pytest.mark.parametrize("processes", [0, 1])
def test_the_last_lines_say_what_was_skipped_and_how_to_have_it(tmp_path: Path, processes: int) -> None:
    code, lines = run(tmp_path, processes)
    assert code == 0, lines
    assert "1 passed, 3 skipped" in lines[-1]
    title, *said, way = lines[-5:-1]
    assert "skipped on this machine" in title
    assert said == ["2 tests: redis-server is not installed", "1 test: PostgreSQL is not installed"]
    assert way == "to run more of them: apt-get install redis-server postgresql, and the same again"


def test_where_servers_are_required_a_missing_one_is_a_failure(tmp_path: Path) -> None:
    code, lines = run(tmp_path, 0, PVG_REQUIRE_SERVERS="1")
    assert code == 1
    assert "2 failed, 1 passed, 1 error" in lines[-1]


def test_where_media_are_required_a_missing_folder_is_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("REQUIRE_MEDIA", raising=False)
    with pytest.raises(pytest.skip.Exception):
        missing("there are none", required_by="REQUIRE_MEDIA")
    monkeypatch.setenv("REQUIRE_MEDIA", "1")
    with pytest.raises(pytest.fail.Exception, match="REQUIRE_MEDIA=1, but there are none"):
        missing("there are none", required_by="REQUIRE_MEDIA")


def run(folder: Path, processes: int, **more: str) -> tuple[int, list[str]]:
    """Tests that need servers, where none is found: the exit code, and what is printed."""
    (folder / "test_tiny.py").write_text(TINY)
    (folder / "conftest.py").write_text(
        "import tests.service.servers as servers\n"
        "servers._postgres_bin = lambda: None\n"  # it is also looked for where Debian has it
        'pytest_plugins = ["tests.parts"]\n'
    )
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PVG_", "PYTEST_"))}
    environment |= {"PATH": "/nonexistent", "PYTHONPATH": str(REPOSITORY), "COLUMNS": "120"}
    environment |= {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"} | more  # the others take seconds to load
    command = [sys.executable, "-m", "pytest", "-q", "-p", "xdist", "-n", str(processes), "-c", os.devnull]
    done = subprocess.run(
        [*command, "--rootdir", folder, folder], env=environment, check=False, stdout=subprocess.PIPE, text=True
    )
    return done.returncode, done.stdout.splitlines()


def test_every_package_is_one_that_is_installed_in_ci() -> None:
    script = (REPOSITORY / ".ci" / "run").read_text()
    assert [package for package in PACKAGES.values() if f"missing+=({package})" not in script] == []
