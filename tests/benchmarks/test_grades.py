from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from benchmarks.grades.drawing import SIZE, draw_sheet
from benchmarks.grades.plan import plan_sheets
from benchmarks.grades.score import Entry, read_key, read_verdicts, score, write_key, write_template

FAR = {Path(f"clip{i}.mp4"): [Path(f"portrait{k}.jpg") for k in range(9)] for i in range(5)}


def test_each_clip_has_its_looks_and_controls_in_mixed_order() -> None:
    sheets = plan_sheets(FAR, 6, 2, 3)
    assert [sheet.number for sheet in sheets] == list(range(1, 41))
    assert Counter((sheet.clip, sheet.control) for sheet in sheets) == {
        (clip, control): 2 if control else 6 for clip in FAR for control in (False, True)
    }
    looks = [(sheet.clip, sheet.reference) for sheet in sheets if not sheet.control]
    assert len(set(looks)) == len(looks)
    assert {sheet.control for sheet in sheets[:20]} == {True, False}
    assert sheets == plan_sheets(FAR, 6, 2, 3)
    assert sheets != plan_sheets(FAR, 6, 2, 4)


def test_more_looks_than_references_are_refused() -> None:
    with pytest.raises(ValueError, match=r"clip0\.mp4: 9 references for 10 sheets"):
        plan_sheets(FAR, 10, 0, 0)


def test_a_sheet_shows_reference_clip_and_result_side_by_side() -> None:
    reference, clip, result = (np.full((500, 700, 3), value, np.uint8) for value in (20, 120, 220))
    window = (slice(100, 400), slice(100, 400))
    sheet = draw_sheet(7, (reference, window), (clip, window), (result, window))
    assert sheet.shape == (SIZE[1], SIZE[0], 3)
    for y in (250, 850):
        assert [int(sheet[y, x, 0]) for x in (200, 750, 1450)] == [20, 120, 220]


def entries() -> list[Entry]:
    return [Entry(n, f"clip{n % 2}", "portrait", 3, control=n > 3) for n in range(1, 6)]


def test_the_score_tells_looks_from_untouched_frames(tmp_path: Path) -> None:
    write_key(tmp_path / "key" / "key.json", entries(), {"seed": 1})
    key = read_key(tmp_path / "key" / "key.json")
    assert list(key.values()) == entries()
    table = tmp_path / "first.csv"
    write_template(table, key)
    assert read_verdicts(table, key) == []
    table.write_text("number,verdict,fault\n1,D,\n2,t,red ears\n3,R,mud\n4,D,\n5,T,too bright\n")
    report = score(read_verdicts(table, key))
    assert "looks             1 of 3 deliverable, 33% (1 to 91 %); 1 to touch up, 1 rejected; wanted ≥ 90%: missed" in (
        report
    )
    assert "untouched frames  1 of 2 deliverable, 50% (1 to 99 %); 1 to touch up, 0 rejected" in report
    assert "  clip0: 0 of 1 deliverable" in report
    faults, of_untouched = report.split("faults of untouched frames")
    assert "  2 T clip0 with portrait: red ears" in faults
    assert "  5 T clip1 with portrait: too bright" in of_untouched


@pytest.mark.parametrize(
    ("line", "told"), [("9,D,", "there is no sheet 9"), ("1,X,", "sheet 1: a verdict is one of D, T, R")]
)
def test_what_is_no_verdict_is_told(tmp_path: Path, line: str, told: str) -> None:
    table = tmp_path / "first.csv"
    table.write_text(f"number,verdict,fault\n{line}\n")
    with pytest.raises(ValueError, match=rf"first\.csv: {told}"):
        read_verdicts(table, {entry.number: entry for entry in entries()})
