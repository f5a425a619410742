"""`python -m benchmarks.blind.score KEY [CHOICES...] [--swapped CHOICES...]`: who was chosen, and why ours lost."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from scipy.stats import binomtest

from benchmarks.blind.key import OURS, KeyEntry, read_choices, read_key
from benchmarks.quality.color import TONE_GROUPS

TARGET = 0.70


@dataclass(frozen=True)
class Judged:
    """One viewer's choice on one sheet."""

    entry: KeyEntry
    choice: str
    reason: str
    viewer: str

    @property
    def for_ours(self) -> bool:
        """Whether ours was chosen."""
        return self.entry.whose(self.choice) == OURS


def swapped(key: dict[int, KeyEntry]) -> dict[int, KeyEntry]:
    """The key of the sheets whose sides are swapped."""
    return {number: replace(entry, a=entry.b, b=entry.a) for number, entry in key.items()}


def judge(key: dict[int, KeyEntry], choices: Iterable[tuple[int, str, str]], viewer: str) -> list[Judged]:
    """A viewer's choices by the key. Raises `ValueError` on a number that the key has not."""
    out = []
    for number, choice, reason in choices:
        if number not in key:
            raise ValueError(f"{viewer}: there is no sheet {number}")
        judged = Judged(key[number], choice, reason, viewer)
        _ = judged.for_ours  # a choice that is neither A nor B is told here
        out.append(judged)
    return out


def interval(wins: int, count: int) -> tuple[float, float]:
    """The 95 % interval of the share (Clopper and Pearson)."""
    found = binomtest(wins, count).proportion_ci(0.95, method="exact")
    return float(found.low), float(found.high)


def wins_of(rows: list[Judged]) -> str:
    """ "18 : 6, 75 % (53 to 90 %)": ours against the rival."""
    wins = sum(row.for_ours for row in rows)
    if not rows:
        return "none judged"
    low, high = interval(wins, len(rows))
    return f"{wins} : {len(rows) - wins}, {100 * wins / len(rows):.0f} % ({100 * low:.0f} to {100 * high:.0f} %)"


def score(rows: list[Judged]) -> str:
    """The report in lines."""
    if not rows:
        return "no sheet was judged"
    rivals = ", ".join(sorted({row.entry.rival for row in rows}))
    met = "met" if sum(row.for_ours for row in rows) >= TARGET * len(rows) else "missed"
    lines = [f"ours : {rivals}", f"  all      {wins_of(rows)}; wanted ≥ {TARGET:.0%}: {met}"]
    for title, groups in (
        ("by viewer", [(name, [r for r in rows if r.viewer == name]) for name in sorted({r.viewer for r in rows})]),
        ("by skin tone of the clip", [(name, [r for r in rows if r.entry.group == name]) for name in TONE_GROUPS]),
        ("by kind", [(kind, [r for r in rows if r.entry.kind == kind]) for kind in ("still", "strip")]),
    ):
        lines.append(title)
        lines += [f"  {name}: {wins_of(part)}" for name, part in groups if part]
    sides = Counter(row.choice for row in rows)
    lines.append(f"sides chosen: A {sides['A']}, B {sides['B']}")
    lines.append("where ours lost")
    for row in rows:
        if not row.for_ours:
            pair = f"{row.entry.clip} with {row.entry.reference}"
            lines.append(f"  {row.entry.number:3d} {pair} ({row.entry.kind}, {row.viewer}): {row.reason or '–'}")
    return "\n".join(lines)


def main() -> None:
    """Score the choices."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind.score", description=__doc__)
    parser.add_argument("key", type=Path)
    parser.add_argument("choices", type=Path, nargs="*", help="of viewers who saw the sheets")
    parser.add_argument(
        "--swapped", type=Path, nargs="*", default=[], help="of viewers who saw those with swapped sides"
    )
    options = parser.parse_args()
    key = read_key(options.key)
    read = [(key, path) for path in options.choices] + [(swapped(key), path) for path in options.swapped]
    print(score([row for one, path in read for row in judge(one, read_choices(path), path.stem)]))


if __name__ == "__main__":
    main()
