"""The tuned numbers: all marked, all frozen, and counted in the documentation."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import re
import sys
from pathlib import Path

import pytest

from pvg.skin.parameters import SKIN_PRIOR, SkinPrior

MARK = re.compile(r"\[(measured: .+|paper|by eye)\]")
DOCS = Path(__file__).resolve().parents[3] / "docs" / "skin.md"


def _numbers(group: object) -> dict[str, str]:
    """The comment of each tuned number of a group."""
    source = inspect.getsource(sys.modules[type(group).__module__])
    node = next(n for n in ast.parse(source).body if isinstance(n, ast.ClassDef) and n.name == type(group).__name__)
    lines = source.splitlines()
    fields = [n for n in node.body if isinstance(n, ast.AnnAssign)]
    return {ast.unparse(n.target): lines[n.lineno - 1].partition("#")[2] for n in fields}


def _groups() -> dict[str, object]:
    return {field.name: getattr(SKIN_PRIOR, field.name) for field in dataclasses.fields(SkinPrior)}


@pytest.mark.parametrize("name", _groups())
def test_every_number_says_where_it_comes_from(name: str) -> None:
    for number, comment in _numbers(_groups()[name]).items():
        assert MARK.search(comment), number


def test_the_numbers_cannot_be_changed() -> None:
    for group in (SKIN_PRIOR, *_groups().values()):
        assert dataclasses.is_dataclass(group)
        assert type(group).__dataclass_params__.frozen  # type: ignore[attr-defined]
    with pytest.raises(dataclasses.FrozenInstanceError):
        SKIN_PRIOR.hair.log_odds = 1.0  # type: ignore[misc]


def test_the_documentation_counts_them() -> None:
    text = DOCS.read_text()
    for name, group in _groups().items():
        comments = _numbers(group).values()
        measured = sum("[measured" in comment for comment in comments)
        assert f"| `{name}` | {len(comments)} | {measured} |" in text, name
