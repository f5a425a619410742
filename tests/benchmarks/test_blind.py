from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.key import OURS, RIVAL, KeyEntry, read_choices, read_key, write_key, write_template
from benchmarks.blind.options import add_material, material_of
from benchmarks.blind.plan import plan_pairs
from benchmarks.blind.score import interval, judge, score, swapped
from benchmarks.blind.sheets import SIZE, draw_sheet
from benchmarks.quality.media import half_of, usable_portraits

CLIPS = [Path(f"clip{i}.mp4") for i in range(8)]
PORTRAITS = [Path(f"portrait{i}.jpg") for i in range(7)]


def entry(number: int, a: str, group: str = "light") -> KeyEntry:
    b = RIVAL if a == OURS else OURS
    return KeyEntry(number, "clip", "portrait", "mk", "still", [3], a, b, 45.0, group)


def test_the_pairs_follow_from_the_seed() -> None:
    assert plan_pairs(CLIPS, PORTRAITS, 40, 3) == plan_pairs(CLIPS, PORTRAITS, 40, 3)
    assert plan_pairs(CLIPS, PORTRAITS, 40, 3) != plan_pairs(CLIPS, PORTRAITS, 40, 4)


def test_every_clip_and_portrait_is_met_alike_half_as_strips_and_half_on_either_side() -> None:
    pairs = plan_pairs(CLIPS, PORTRAITS, 40, 0)
    assert len({(pair.clip, pair.reference) for pair in pairs}) == 40
    assert set(Counter(pair.clip for pair in pairs).values()) == {5}
    assert set(Counter(pair.reference for pair in pairs).values()) <= {5, 6}
    assert sum(pair.strip for pair in pairs) == sum(pair.ours_is_a for pair in pairs) == 20


def test_a_strip_is_spread_over_the_frames_with_a_face() -> None:
    pairs = plan_pairs(CLIPS, PORTRAITS, 4, 0)
    seen = list(range(100, 201))
    for pair in pairs:
        frames = pair.frames(seen)
        assert frames == ([108, 136, 164, 192] if pair.strip else frames[:1])
        assert set(frames) <= set(seen)
        assert pair.frames([7]) == [7]


def test_clips_and_pictures_of_another_folder_are_all_taken(tmp_path: Path) -> None:
    for name in ("b.png", "a.mp4", "c.jpg"):
        (tmp_path / name).touch()
    (tmp_path / "folder").mkdir()
    parser = argparse.ArgumentParser()
    add_material(parser, half="report", seed_of="nothing", folder="blind")
    clips, portraits = material_of(parser.parse_args(["--clips-in", str(tmp_path)]))
    assert [clip.name for clip in clips] == ["a.mp4", "b.png", "c.jpg"]
    assert portraits == material_of(parser.parse_args([]))[1]


def test_the_halves_share_nothing_and_odd_portraits_are_left_out() -> None:
    assert sorted(half_of(PORTRAITS, "tune") + half_of(PORTRAITS, "report")) == PORTRAITS
    assert half_of(PORTRAITS, "all") == tuple(PORTRAITS)
    assert usable_portraits([Path("woman_astronaut_small_face.jpg"), Path("group_four.jpg"), PORTRAITS[0]]) == [
        PORTRAITS[0]
    ]


def test_the_sheets_sides_are_those_of_the_key() -> None:
    ours, rival = np.full((60, 80, 3), 250, np.uint8), np.full((60, 80, 3), 5, np.uint8)
    window = (slice(10, 50), slice(10, 60))
    for count in (1, 4):
        sheet = draw_sheet(1, ours, ([ours] * count, [rival] * count), [window] * count)
        assert sheet.shape == (SIZE[1], SIZE[0], 3)
        middle = (250, 500) if count == 1 else (300, 420)
        other = (250, 1150) if count == 1 else (800, 420)
        assert sheet[middle].tolist() == [250] * 3
        assert sheet[other].tolist() == [5] * 3


def test_the_key_tells_whose_choice_it_was(tmp_path: Path) -> None:
    write_key(tmp_path / "key" / "key.json", [entry(1, OURS), entry(2, RIVAL)], {"seed": 0})
    key = read_key(tmp_path / "key" / "key.json")
    assert [key[1].whose("A"), key[1].whose("B"), key[2].whose("A"), key[2].whose("B")] == [OURS, RIVAL, RIVAL, OURS]
    with pytest.raises(ValueError, match="sheet 2"):
        key[2].whose("both")


def test_a_table_not_filled_in_counts_for_nothing(tmp_path: Path) -> None:
    write_template(tmp_path / "choices.csv", [1, 2])
    assert read_choices(tmp_path / "choices.csv") == []
    (tmp_path / "choices.csv").write_text('number,choice,reason\n1,,\n2, b ,"grey, flat"\n')
    assert read_choices(tmp_path / "choices.csv") == [(2, "B", "grey, flat")]


def test_the_score_counts_wins_by_group_and_gives_reasons() -> None:
    key = {k: entry(k, OURS if k % 2 else RIVAL, "light" if k < 7 else "brown") for k in range(1, 11)}
    choices = [(k, key_side, "") for k, key_side in ((k, "A" if k % 2 else "B") for k in range(1, 8))]
    choices += [(8, "A", "flat"), (9, "B", "halo"), (10, "B", "")]
    text = score(judge(key, choices, "anna"))
    assert "8 : 2, 80 %" in text
    assert "light: 6 : 0" in text
    assert "brown: 2 : 2" in text
    assert "flat" in text
    assert "halo" in text
    with pytest.raises(ValueError, match="no sheet 11"):
        judge(key, [(11, "A", "")], "anna")


def test_the_interval_is_the_exact_binomial_one() -> None:
    assert interval(10, 10) == pytest.approx((0.025**0.1, 1.0))
    low, high = interval(20, 40)
    assert low == pytest.approx(1 - high)
    assert 0.33 < low < 0.35


def test_a_viewer_who_always_takes_the_left_one_says_nothing_with_sides_swapped() -> None:
    key = {number: entry(number, OURS if number % 3 else RIVAL) for number in range(1, 13)}
    left = [(number, "A", "") for number in key]
    rows = judge(key, left, "one") + judge(swapped(key), left, "two")
    assert sum(row.for_ours for row in rows) == len(key)
