"""`python -m benchmarks.grades.score KEY VERDICTS...`: how many looks and untouched frames are deliverable."""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from benchmarks.blind.score import interval
from benchmarks.blind.tables import Columns, read_table, write_table

VERDICTS = {"D": "deliverable", "T": "to touch up", "R": "rejected"}
GRADES: Final[Columns] = ("verdict", "fault")
TARGET = 0.9


@dataclass(frozen=True)
class Entry:
    """What a sheet shows; a control is a frame that nobody touched."""

    number: int
    clip: str
    reference: str
    frame: int
    control: bool


@dataclass(frozen=True)
class Graded:
    """One viewer's verdict, of VERDICTS, on a sheet, and the fault named."""

    entry: Entry
    verdict: str
    fault: str
    viewer: str


def write_key(path: Path, entries: list[Entry], about: dict[str, Any]) -> None:
    """Write the entries and how the set was made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({**about, "sheets": [asdict(entry) for entry in entries]}, indent=1))


def read_key(path: Path) -> dict[int, Entry]:
    """The entries by number."""
    entries = [Entry(**one) for one in json.loads(path.read_text())["sheets"]]
    return {entry.number: entry for entry in entries}


def write_template(path: Path, numbers: Iterable[int]) -> None:
    """Write the table that a viewer fills in: number, verdict (D, T or R), fault."""
    write_table(path, GRADES, numbers)


def read_verdicts(path: Path, key: dict[int, Entry]) -> list[Graded]:
    """The sheets that a viewer graded. Raises `ValueError` on a number or a verdict that is none."""
    out = []
    for number, verdict, fault in read_table(path, GRADES):
        if number not in key:
            raise ValueError(f"{path.name}: there is no sheet {number}")
        if verdict not in VERDICTS:
            raise ValueError(f"{path.name}: sheet {number}: a verdict is one of {', '.join(VERDICTS)}")
        out.append(Graded(key[number], verdict, fault, path.stem))
    return out


def shares(rows: list[Graded]) -> str:
    """ "17 of 30 deliverable, 57 % (37 to 75 %); 11 to touch up, 2 rejected"."""
    if not rows:
        return "none graded"
    count = Counter(row.verdict for row in rows)
    good, low, high = count["D"], *interval(count["D"], len(rows))
    return (
        f"{good} of {len(rows)} deliverable, {good / len(rows):.0%} ({100 * low:.0f} to {100 * high:.0f} %); "
        f"{count['T']} to touch up, {count['R']} rejected"
    )


def score(rows: list[Graded]) -> str:
    """The report in lines."""
    looks, untouched = ([row for row in rows if row.entry.control is control] for control in (False, True))
    if not looks:
        return "no look was graded"
    met = "met" if sum(row.verdict == "D" for row in looks) >= TARGET * len(looks) else "missed"
    lines = [
        f"looks             {shares(looks)}; wanted ≥ {TARGET:.0%}: {met}",
        f"untouched frames  {shares(untouched)}",
    ]
    names: tuple[tuple[str, Callable[[Graded], str]], ...] = (
        ("viewer", lambda row: row.viewer),
        ("clip", lambda row: row.entry.clip),
        ("reference", lambda row: row.entry.reference),
    )
    for title, name in names:
        lines.append(f"looks by {title}")
        found = sorted({name(row) for row in looks})
        lines += [f"  {one}: {shares([row for row in looks if name(row) == one])}" for one in found]
    for title, part in (("faults of looks", looks), ("faults of untouched frames", untouched)):
        lines.append(title)
        lines += [
            f"  {row.entry.number:3d} {row.verdict} {row.entry.clip} with {row.entry.reference}: {row.fault or '–'}"
            for row in part
            if row.verdict != "D"
        ]
    return "\n".join(lines)


def main() -> None:
    """Score the verdicts."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.grades.score", description=__doc__)
    parser.add_argument("key", type=Path)
    parser.add_argument("verdicts", type=Path, nargs="+", help="of viewers who saw the sheets")
    options = parser.parse_args()
    key = read_key(options.key)
    print(score([row for path in options.verdicts for row in read_verdicts(path, key)]))


if __name__ == "__main__":
    main()
