from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pvg._outputs import outputs


@pytest.mark.parametrize(
    ("references", "names"),
    [
        ("a b", "a b"),
        ("a a b", "a-1 a-2 b"),
        ("a a a-2", "a-1 a-2-2 a-2"),
        ("a-2 a a", "a-2 a-2-2 a-3"),
        ("a a a-2 a-2", "a-1 a-2-2 a-2-3 a-2-4"),
        ("a a a-2 a-2-2", "a-1 a-2-2-2 a-2 a-2-2"),
    ],
)
def test_no_two_looks_have_one_name(references: str, names: str, tmp_path: Path) -> None:
    video: Any = SimpleNamespace(media=SimpleNamespace(kind="video"))
    given = [Path(f"{k}") / f"{stem}.jpg" for k, stem in enumerate(references.split())]
    assert outputs(tmp_path, given, video) == [tmp_path / f"{name}.mp4" for name in names.split()]
