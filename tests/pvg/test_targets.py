from __future__ import annotations

import os
from pathlib import Path

import pytest

from pvg._targets import begin_draft, check_file, check_folder, draft_of
from tests.folders import permissions, umask_of


def test_two_drafts_of_one_file_are_two_files(tmp_path: Path) -> None:
    assert len({draft_of(tmp_path / "look.mp4") for _ in range(100)}) == 100


def test_a_draft_stands_beside_its_file_and_is_named_like_it(tmp_path: Path) -> None:
    draft = draft_of(tmp_path / "job_0123.look.mp4")
    assert draft.parent == tmp_path
    assert draft.name.startswith(".job_0123.look.")
    assert draft.suffix == ".mp4"


def test_drafts_of_the_longest_names_can_be_written(tmp_path: Path) -> None:
    ends = ["x" * 251 + ".mp4", "é" * 125 + ".webm", "ü" * 127, "x." + "y" * 253, os.fsdecode(b"\xff" * 251 + b".png")]
    for name in ends:
        (tmp_path / name).write_bytes(b"")
        draft = draft_of(tmp_path / name)
        draft.write_bytes(b"")
        draft.name.encode()
        draft.replace(tmp_path / name)


def test_what_no_file_can_be_called_is_refused(tmp_path: Path) -> None:
    for check in (check_file, lambda path, _: check_folder(path)):
        for path in (tmp_path / "a\0b.mp4", tmp_path / "a\0b" / "o.mp4"):
            with pytest.raises(ValueError, match="has a NUL in it"):
                check(path, [])


@pytest.mark.parametrize(("there", "umask", "drawn"), [(0o600, 0o022, 0o600), (0o640, 0o002, 0o640), (0o444, 0, 0o644)])
def test_a_draft_is_as_private_as_what_it_replaces(there: int, umask: int, drawn: int, tmp_path: Path) -> None:
    path = tmp_path / "clip.pvg"
    path.touch()
    path.chmod(there)
    with umask_of(umask):
        begin_draft(draft := draft_of(path), path)
    assert permissions(draft) == drawn


def test_the_umask_says_who_may_read_a_new_file(tmp_path: Path) -> None:
    with umask_of(0o027):
        begin_draft(draft := draft_of(tmp_path / "new.pvg"), tmp_path / "new.pvg")
    assert permissions(draft) == 0o640
