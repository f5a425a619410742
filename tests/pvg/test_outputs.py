from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pvg._outputs import NAMED_AS_FILES, check_outputs, check_results_folder, outputs
from pvg.video import CLIP_SUFFIXES, IMAGE_SUFFIXES


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


def test_a_folder_may_have_a_point_in_its_name_but_not_that_of_a_file(tmp_path: Path) -> None:
    assert {*NAMED_AS_FILES} == {*CLIP_SUFFIXES, *IMAGE_SUFFIXES, ".pvg"}
    references = [Path("a.jpg"), Path("b.jpg")]
    check_outputs(tmp_path / "folder.v1", references, [])
    for name in ("o.mp4", "o.PNG", "o.pvg"):
        with pytest.raises(ValueError, match=f"{name} is named as a file is; several references need a folder"):
            check_outputs(tmp_path / name, references, [])
        (tmp_path / name).mkdir()
        check_results_folder(tmp_path / name, "both results")
    (tmp_path / "file.v1").touch()
    with pytest.raises(ValueError, match=r"file\.v1 is a file"):
        check_outputs(tmp_path / "file.v1", references, [])
