from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pvg._outputs import check_outputs, outputs


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


@pytest.mark.parametrize(
    ("name", "container"),
    [("o.m4v", "mp4"), ("o.MKV", "mkv"), ("o.jpeg", "jpg"), ("o.tif", "tiff"), ("o.tiff", "tiff")],
)
def test_a_file_may_be_named_as_its_container_is_by_others(name: str, container: str, tmp_path: Path) -> None:
    check_outputs(tmp_path / name, [Path("a.jpg")], [], container)
    with pytest.raises(ValueError, match="is not named as webp is"):
        check_outputs(tmp_path / name, [Path("a.jpg")], [], "webp")
