"""The locks name the same versions as constraints.txt, each with hashes; and what an audit of them says."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from scripts.audit import CLEAN, KNOWN, NOT_ASKED, judged

ROOT = Path(__file__).resolve().parents[1]
#: of other platforms and older Pythons than those constraints.txt was made on
ELSEWHERE = {"async-timeout", "colorama", "tzdata"}


def pinned(path: Path) -> dict[str, str]:
    found = re.findall(r"^([A-Za-z0-9_.-]+)==([^ ;\n]+)", path.read_text(), re.MULTILINE)
    return {re.sub(r"[-_.]+", "-", name).lower(): version for name, version in found}


def test_the_lock_of_everything_is_the_constraints() -> None:
    locked = pinned(ROOT / "requirements" / "all.txt")
    assert {name: version for name, version in locked.items() if name not in ELSEWHERE} == pinned(
        ROOT / "constraints.txt"
    )


@pytest.mark.parametrize("name", ["all.txt", "service.txt", "api.txt"])
def test_every_locked_version_has_hashes(name: str) -> None:
    lock, whole = (pinned(ROOT / "requirements" / one) for one in (name, "all.txt"))
    assert lock.items() <= whole.items()
    blocks = re.split(r"\n(?=\S)", (ROOT / "requirements" / name).read_text().strip())
    assert len(blocks) == len(lock)
    assert all(re.search(r"--hash=sha256:[0-9a-f]{64}", block) for block in blocks)


def test_the_lock_of_the_api_has_what_it_needs_and_none_of_the_method() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    api, service = (set(pinned(ROOT / "requirements" / name)) for name in ("api.txt", "service.txt"))
    extras = project["optional-dependencies"]
    assert {named(one) for one in (*extras["service"], *extras["postgres"])} <= api <= service
    assert not api & {named(one) for one in project["dependencies"]}


def named(requirement: str) -> str:
    return re.split(r"[\[<>=~! ]", requirement)[0].lower()


def test_an_audit_that_asked_nobody_does_not_pass() -> None:
    skipped, clean = {"name": "a", "skip_reason": "not found"}, {"name": "b", "version": "1", "vulns": []}
    assert judged([skipped])[0] == NOT_ASKED
    assert judged([skipped, clean]) == (CLEAN, "1 of 2 dependencies audited, 0 known weaknesses")
    found, said = judged([clean, clean | {"vulns": [{"id": "PYSEC-1"}]}])
    assert (found, said.splitlines()[1]) == (KNOWN, "b 1: PYSEC-1")
