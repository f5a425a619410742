from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import pytest

from pvg.video import make_plan, probe, read_streams
from pvg.video.streams import Chapter
from tests.gallery.clips import rewrite_clip, short_clip

_LENGTH_S = Fraction(20, 25)


def _with_chapters(folder: Path, chapters: list[tuple[str, str, str | None]]) -> Path:
    """A Matroska clip of 0.8 s with chapters, in seconds, as they are given."""
    plain = short_clip(folder / "plain.mkv")
    plan = make_plan(probe(plain), container="mkv", source=plain, streams=read_streams(plain))
    made = tuple(Chapter(Fraction(start), Fraction(end), title) for start, end, title in chapters)
    return rewrite_clip(plain, folder / "i.mkv", replace(plan, chapters=made))


@pytest.mark.parametrize("suffix", [".mp4", ".mov", ".mkv"])
def test_chapters_without_a_name_stay_where_they_are(suffix: str, tmp_path: Path) -> None:
    source = _with_chapters(tmp_path, [("0", "0.2", None), ("0.2", "0.5", "two"), ("0.5", "0.8", None)])
    chapters = read_streams(source).chapters
    assert [chapter.title for chapter in chapters] == [None, "two", None]
    assert read_streams(rewrite_clip(source, tmp_path / f"o{suffix}")).chapters == chapters


@pytest.mark.parametrize("suffix", [".mp4", ".mov"])
def test_a_clip_is_not_made_longer_by_its_chapters(suffix: str, tmp_path: Path) -> None:
    source = _with_chapters(tmp_path, [("0", "0.4", "one"), ("0.4", "60", "two"), ("60", "90", "three")])
    target = rewrite_clip(source, tmp_path / f"o{suffix}")
    assert [(one.start_s, one.title) for one in read_streams(target).chapters] == [(0, "one"), (Fraction(2, 5), "two")]
    with av.open(str(target)) as clip:
        assert clip.duration == pytest.approx(float(_LENGTH_S) * 1e6, abs=1000)
    plan = make_plan(probe(source), container=suffix, source=source, streams=read_streams(source))
    assert "1 chapters that begin after the clip's end are not kept" in plan.dropped
