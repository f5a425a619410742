"""The key of a set of sheets: whose result is on which side."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from benchmarks.blind.tables import Columns, read_table, write_table

CHOICES: Final[Columns] = ("choice", "reason")
OURS, RIVAL = "ours", "rival"


@dataclass(frozen=True)
class KeyEntry:
    """What one sheet shows. a, b: "ours" or "rival";  ita: of the clip's skin in degrees;  group: its name."""

    number: int
    clip: str
    reference: str
    rival: str
    kind: str
    frames: list[int]
    a: str
    b: str
    ita: float
    group: str

    def whose(self, choice: str) -> str:
        """Whose result a viewer chose by "A" or "B". Raises `ValueError` on anything else."""
        if choice not in ("A", "B"):
            raise ValueError(f"sheet {self.number}: the choice must be A or B, not {choice!r}")
        return self.a if choice == "A" else self.b


def write_key(path: Path, entries: list[KeyEntry], about: dict[str, Any]) -> None:
    """Write the entries and how the set was made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({**about, "pairs": [asdict(entry) for entry in entries]}, indent=1))


def read_key(path: Path) -> dict[int, KeyEntry]:
    """The entries by number."""
    entries = [KeyEntry(**one) for one in json.loads(path.read_text())["pairs"]]
    return {entry.number: entry for entry in entries}


def write_template(path: Path, numbers: list[int]) -> None:
    """Write the table that a viewer fills in: number, choice (A or B), reason."""
    write_table(path, CHOICES, numbers)


def read_choices(path: Path) -> list[tuple[int, str, str]]:
    """(number, "A" or "B", reason) of the sheets that a viewer judged."""
    return read_table(path, CHOICES)
