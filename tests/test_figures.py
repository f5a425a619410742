"""Figures that README and docs/paper.md repeat are those of docs/quality.md."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
QUALITY = REPOSITORY / "docs" / "quality.md"

#: names of rows of docs/paper.md -> the rows of docs/quality.md whose figures stand there, in their order
ROWS = {
    "open skin closer to the reference's": ["closer: sliced Wasserstein of skin, %"],
    "ΔE2000 of the median skin, median; p90": ["colour: ΔE2000, median", "colour: ΔE2000, 90th percentile"],
    "slope of tonal contrast; correlation": ["tonal contrast, slope", "tonal contrast, correlation"],
    "spread of hue and chroma, slope": ["spread of hue and chroma, slope"],
    "lips; lids; blush carried": ["parts: lips carried, %", "parts: lids carried, %", "parts: blush carried, %"],
    "place of light, correlation": ["place of light, correlation"],
    "one person, ΔE2000 of neck, ears, hands": ["one person: ΔE2000 of neck, ears, hands, median"],
    "warping error, whole frame; face and edge": [
        "warping error, whole frame, median case",
        "warping error, face and edge, median case",
    ],
    "leak of a growing bright panel": ["leak of a growing bright panel, worst, levels"],
}
#: of docs/paper.md -> of docs/quality.md
ROUNDS = {
    "chosen blind over the paper's way": ["the paper's way, with our mask"],
    "chosen blind over masked Monge–Kantorovich (Lab)": ["masked Monge–Kantorovich in Lab"],
    "chosen blind over masked Reinhard; raster OMT": ["masked Reinhard in Lab", "raster OMT"],
}


def tables(path: Path) -> list[list[dict[str, str]]]:
    """The tables of a page, each as rows of cells by the heads of their columns."""
    found: list[list[dict[str, str]]] = []
    for block in re.findall(r"(?:^\|.*\n)+", path.read_text(), re.MULTILINE):
        head, _, *rows = ([cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in block.splitlines())
        found.append([dict(zip(head, row, strict=True)) for row in rows])
    return found


def of_columns(path: Path, *names: str) -> dict[str, dict[str, str]]:
    """The rows of the first table that has these columns, by their first cell."""
    table = next(table for table in tables(path) if set(names) <= set(table[0]))
    return {next(iter(row.values())): row for row in reversed(table)}


@pytest.fixture(scope="module")
def measured() -> dict[str, dict[str, str]]:
    return of_columns(QUALITY, "measure", "ours, scene = 0", "raster OMT")


def figures(cell: str) -> list[str]:
    return re.findall(r"-?\d+(?:\.\d+)?", cell)


def test_what_the_readme_repeats_is_the_same(measured: dict[str, dict[str, str]]) -> None:
    repeated = of_columns(REPOSITORY / "README.md", "measure", "ours", "the paper's way")
    assert len(repeated) >= 5
    for name, row in repeated.items():
        assert row == {column: measured[name][column] for column in row}


def test_the_count_of_targets_that_are_met_is_the_same(measured: dict[str, dict[str, str]]) -> None:
    cells = (row["ours"] + row["ours, λ = 1"] * ("λ = 1" in row["target"]) for row in measured.values())
    judged = [cell for cell in cells if "met" in cell or "missed" in cell]
    met = sum("missed" not in cell for cell in judged)
    for path, told in ((QUALITY, "Targets on whole clips: {} of {} met"), (REPOSITORY / "README.md", "Of {1} targets")):
        assert told.format(met, len(judged)) in path.read_text()
    assert f"whole clips, {met} are met" in (REPOSITORY / "README.md").read_text()


@pytest.mark.parametrize(("name", "rows"), ROWS.items())
def test_what_the_papers_page_repeats_is_the_same(
    measured: dict[str, dict[str, str]], name: str, rows: list[str]
) -> None:
    repeated = of_columns(REPOSITORY / "docs" / "paper.md", "measure", "wanted", "the paper's way", "ours")[name]
    for column in ("the paper's way", "ours"):
        assert figures(repeated[column])[: len(rows)] == [figures(measured[row][column])[0] for row in rows]
    for row in rows:
        assert repeated["wanted"] == "–" or figures(measured[row]["target"])[0] in figures(repeated["wanted"])


@pytest.mark.parametrize(("name", "rows"), ROUNDS.items())
def test_blind_rounds_are_the_same(name: str, rows: list[str]) -> None:
    rounds = of_columns(QUALITY, "ours against", "seed", "ours chosen")
    repeated = of_columns(REPOSITORY / "docs" / "paper.md", "measure", "wanted", "ours")[name]["ours"]
    assert re.findall(r"\d+ of 40", repeated) == [rounds[row]["ours chosen"] for row in rows]
    told = (REPOSITORY / "README.md").read_text()
    assert all(re.search(rf"{rounds[row]['ours chosen']}\b", told) for row in rows)


def test_the_grades_that_the_readme_repeats_are_the_same() -> None:
    rounds = of_columns(QUALITY, "round", "looks deliverable", "looks rejected", "controls deliverable")
    good, looks = figures(rounds["all together"]["looks deliverable"])[:2]
    rejected = rounds["all together"]["looks rejected"]
    fine, controls = figures(rounds["all together"]["controls deliverable"])[:2]
    newest = list(rounds.values())[1:4]  # from below: after the row of all together
    of_newest = [
        sum(int(figures(row[column])[place]) for row in newest)
        for column in ("looks deliverable", "controls deliverable")
        for place in (0, 1)
    ]
    told = " ".join((REPOSITORY / "README.md").read_text().split())
    touched_up = int(looks) - int(good) - int(rejected)
    passed, failed = (
        f"{good} of {looks} looks deliverable",
        f"said that {touched_up} need a touch-up, and rejected {rejected}",
    )
    assert f"{passed}, {failed}" in told
    assert f"{fine} of the {controls} untouched frames deliverable" in told
    assert "{} of {} looks and {} of {} frames".format(*of_newest) in told
