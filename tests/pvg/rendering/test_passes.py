from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

import pytest

import pvg
from pvg.rendering import source_frame
from pvg.rendering.passes import drafts_of, draw
from pvg.video import Frame, Patch
from tests.folders import permissions, umask_of


class _Kept:
    """Keeps the numbers of the frames that it is given."""

    def __init__(self) -> None:
        self.frames: list[int] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: Any) -> None:
        return None

    def write(self, frame: Frame, patches: Sequence[Patch] = ()) -> None:
        self.frames.append(frame.index)


@pytest.mark.parametrize(("at_once", "passes"), [(1, 3), (2, 2), (3, 1)])
def test_each_of_several_passes_begins_with_what_others_freed(
    at_once: int,
    passes: int,
    video: pvg.VectorVideo,
    dark_reference: pvg.VectorVideo,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given_back: list[int] = []
    monkeypatch.setattr("pvg.rendering.passes.give_back", lambda: given_back.append(len(told)))
    monkeypatch.setattr("pvg.rendering.passes.map_large_blocks", lambda: mapped.append(True))
    mapped: list[bool] = []
    look = pvg.transfer(video, dark_reference)
    frames, written = [source_frame(video, k) for k in range(2)], [_Kept() for _ in range(3)]
    told: list[tuple[str, int, int]] = []
    draw(
        video,
        [look] * 3,
        lambda: iter(frames),
        written.__getitem__,
        count=2,
        at_once=at_once,
        progress=lambda *at: told.append(at),
    )
    assert all(one.frames == [0, 1] for one in written)
    assert told == [("render", done + 1, 2 * passes) for done in range(2 * passes)]
    # a single pass has nothing before it
    assert mapped == [True] * (passes > 1)
    assert given_back == ([2 * k for k in range(passes)] if passes > 1 else [])


def test_results_that_replace_private_ones_are_private_while_they_are_written_and_afterwards(tmp_path: Path) -> None:
    former, new = tmp_path / "former.mp4", tmp_path / "new.mp4"
    former.touch()
    former.chmod(0o600)
    with umask_of(0o022), drafts_of([former, new]) as drafts:
        assert [permissions(draft) for draft in drafts] == [0o600, 0o644]
        for draft in drafts:
            draft.write_bytes(b"drawn")
    assert [permissions(path) for path in (former, new)] == [0o600, 0o644]
    assert sorted(tmp_path.iterdir()) == [former, new]
