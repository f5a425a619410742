"""The tables that viewers fill in: a sheet's number, a word of the viewer's, and why."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path

Columns = tuple[str, str]
"""The names of the columns of the word and of the reason."""


def write_table(path: Path, columns: Columns, numbers: Iterable[int]) -> None:
    """Write a table to be filled in for sheets of these numbers."""
    with path.open("w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(("number", *columns))
        writer.writerows((number, "", "") for number in numbers)


def read_table(path: Path, columns: Columns) -> list[tuple[int, str, str]]:
    """(number, word in capitals, reason) of the rows that have a word."""
    word, why = columns
    with path.open(newline="") as lines:
        rows = [
            (int(row["number"]), (row[word] or "").strip().upper(), (row[why] or "").strip())
            for row in csv.DictReader(lines)
        ]
    return [row for row in rows if row[1]]


def check_unfilled(path: Path, columns: Columns) -> None:
    """Raise `SystemExit` where a viewer has filled in the table that would be written."""
    if path.exists() and read_table(path, columns):
        raise SystemExit(f"{path} is filled in; move it away or take another folder with --out")
