from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks.quality import report
from benchmarks.quality.peers import FULL, OURS, PAPER
from benchmarks.quality.summary import MEASURES, closer


def case(method: str, steady: float) -> dict[str, Any]:
    numbers = dict.fromkeys(
        ("steady_whole", "steady_face", "raw_whole", "raw_face", "warping_whole", "warping_face", "warping_inner"),
        steady,
    )
    named = {"clip": "clip", "method": method, "reference": "pale", "reference_ita": 50.0}
    return {**named, **numbers, "detail": 0.99, "psnr_whole": [30.0, 30.1], "frames": 2, "first": 0}


def color(method: str, reference: str, lips: list[float]) -> dict[str, Any]:
    return {
        **{"clip": "clip", "frame": 0, "reference": reference, "reference_ita": 20.0, "method": method},
        **{"distance_before": 20.0, "distance": 5.0, "delta_e_before": 15.0, "delta_e": 1.0, "lips": lips},
        "reference_bearded": reference == "bearded",
        "tones": [20.0, 25.0, 30.0 if reference == "pale" else 20.0],
    }


def results(full: bool) -> dict[str, Any]:
    methods = (*OURS, PAPER, *((FULL,) if full else ()))
    colors = [color(m, r, [7.0 if m == FULL else 1.0, 10.0]) for m in methods for r in ("pale", "brown")]
    cases = [case(m, 0.01 if m == OURS[0] else 0.05) for m in methods]
    row = {
        "picture": "label",
        "reference": "pale",
        "method": OURS[0],
        "D": 20.0,
        "face": 0.9,
        "ΔE neck": 3.0,
        "glow": 0.01,
    }
    lifted = {
        "clip": "clip",
        "up": True,
        "method": OURS[0],
        "reference": "pale",
        "white": 0.5,
        "step": 1.0,
        "step_in": 1.0,
    }
    return {
        "clips": [{"clip": "clip", "ita": 45.0, "frames": 2, "cases": cases, "colors": colors, "paper": True}],
        "truth": [{"clip": "clip", "rows": [{"frame": 0.0, "table": 1.0, "chain": 2.0, "chain, reset": 4.0}]}],
        "ramp": [{**lifted, "delta_e": [3.0, 4.0, 9.0]}],
        "leak": [{"scene": "s", "method": OURS[0], "reference": "pale", "leak": 0.1, "curve": [1.0], "frames": [0]}],
        "regions": [row],
        "regions_left_out": ["label, person 1: no tracked face"],
        "masks": [],
        "about": {
            **{"source": "here", "frames": None, "references": ["pale"], "portraits": ["pale", "brown"]},
            **{"unusable_portraits": [], "paper_failures": {}, "not_installed": {}, "seconds": 1, "processor_s": 2},
        },
    }


def value(name: str, found: dict[str, Any], method: str) -> float | None:
    (measure,) = [one for one in MEASURES if one.name.startswith(name)]
    return measure.value(found, method)


def test_each_measure_reads_its_own_figures() -> None:
    found = results(full=False)
    assert value("steadiness, face, less", found, OURS[0]) == pytest.approx(0.01)
    assert value("exposure ramp: ΔE2000", found, OURS[0]) == 9.0
    assert value("truth of g, mean", found, PAPER) == 4.0
    assert value("one person", found, OURS[0]) == 3.0
    assert value("mask IoU, mean", found, OURS[0]) is None
    assert value("tonal contrast, slope", found, OURS[0]) is None  # two references make no correlation
    assert closer(found["clips"][0]["colors"]) == pytest.approx(75)


def test_parts_are_asked_of_full_strength_where_there_is_such_an_option() -> None:
    assert value("parts: lips", results(full=False), OURS[0]) == pytest.approx(10)
    assert value("parts: lips", results(full=True), OURS[0]) == pytest.approx(70)
    assert value("parts: lips", results(full=True), PAPER) == pytest.approx(10)


def test_lips_in_the_shade_of_a_beard_are_counted_apart() -> None:
    found = results(full=False)
    found["clips"][0]["colors"] += [color(OURS[0], "bearded", [-1.0, 10.0])]
    assert value("parts: lips", found, OURS[0]) == pytest.approx(100 / 30)
    assert value("lips carried, of references without a beard", found, OURS[0]) == pytest.approx(10)


def test_the_report_says_what_is_met_and_what_is_missed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "save_sheet", lambda *_: None)
    monkeypatch.setattr(report, "draw_plots", lambda *_: [])
    text = report.write_report(results(full=False), tmp_path)
    rows = {line.split(" | ")[0].removeprefix("| "): line for line in text.splitlines() if line.startswith("| ")}
    assert "0.0100 met | 0.0500 **missed**" in rows["steadiness, face, less its mean over 1 s, dB"]
    assert "**missed**" in rows["exposure ramp: skin at white, worst"]
    written = (tmp_path / "report.md").read_text()
    assert "no tracked face" in written
    assert json.loads((tmp_path / "report.json").read_text())["clips"]
