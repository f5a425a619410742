"""One release is one number: the library, the service, the client and the changelog have the same."""

from __future__ import annotations

import re
import subprocess
import sys
from datetime import date
from pathlib import Path

import pvg
import pvg_client
from service.version import VERSION
from tests.service.fixtures import Api, api, settings

__all__ = ["api", "settings"]

CHANGELOG = Path(__file__).parents[1] / "CHANGELOG.md"


def test_library_service_and_client_are_of_one_version() -> None:
    assert pvg.__version__ == VERSION == pvg_client.__version__


def test_the_changelog_tells_of_this_version_with_its_day() -> None:
    unreleased, newest, *_ = re.findall(r"^## (.*)$", CHANGELOG.read_text(), re.MULTILINE)
    assert unreleased == "Unreleased"
    number, day = re.fullmatch(r"(\S+) \((\S+)\)", newest).groups()  # type: ignore[union-attr]
    assert number == VERSION
    assert date.fromisoformat(day).isoformat() == day


def test_the_command_tells_its_version() -> None:
    done = subprocess.run(
        [sys.executable, "-c", "import pvg_service; pvg_service.main()", "--version"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == f"pvg-service {VERSION}\n"


def test_the_description_of_the_interface_has_it(api: Api) -> None:
    assert api.client.get("/openapi.json").json()["info"]["version"] == VERSION
