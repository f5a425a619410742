"""`python -m benchmarks.blind`: sheets of ours beside a rival, for eyes that do not know which is which."""

from __future__ import annotations

import argparse
import tempfile
from itertools import groupby
from pathlib import Path

from benchmarks.blind.drawing import RIVALS, DrawnPair, draw_at_revision, draw_clip, revision_of
from benchmarks.blind.key import CHOICES, OURS, RIVAL, KeyEntry, write_key, write_template
from benchmarks.blind.options import add_material, emptied, material_of
from benchmarks.blind.plan import plan_pairs
from benchmarks.blind.sheets import draw_sheet
from benchmarks.blind.tables import check_unfilled
from benchmarks.quality.color import tone_group
from benchmarks.quality.faces import Image
from pvg.video import write_image


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind", description=__doc__)
    parser.add_argument("--against", required=True, help=f"{', '.join(RIVALS)}, or a git revision of this project")
    parser.add_argument("--pairs", type=int, default=40, help="sheets")
    add_material(parser, half="report", seed_of="pairs, sides and frames", folder="blind")
    return parser.parse_args()


def _entry(drawn: DrawnPair, against: str) -> KeyEntry:
    pair = drawn.pair
    sides = (OURS, RIVAL) if pair.ours_is_a else (RIVAL, OURS)
    return KeyEntry(
        pair.number,
        pair.clip.stem,
        pair.reference.stem,
        against,
        "strip" if pair.strip else "still",
        drawn.frames,
        *sides,
        ita=round(drawn.ita, 1),
        group=tone_group(drawn.ita),
    )


def _save(drawn: DrawnPair, rival: list[Image], folder: Path) -> None:
    """Two sheets of a pair, the second one with its sides swapped, for another viewer."""
    sides = (drawn.ours, rival) if drawn.pair.ours_is_a else (rival, drawn.ours)
    for name, shown in (("sheets", sides), ("sheets-swapped", (sides[1], sides[0]))):
        sheet = draw_sheet(drawn.pair.number, drawn.reference, shown, drawn.crops)
        write_image(folder / name / f"{drawn.pair.number:03d}.png", sheet)


def main() -> None:
    """Draw the sheets, the key and the table to fill in."""
    options = _options()
    tables = [options.out / name for name in ("choices.csv", "choices-swapped.csv")]
    for choices in tables:
        check_unfilled(choices, CHOICES)
    commit = None if options.against in RIVALS else revision_of(options.against)
    clips, portraits = material_of(options)
    pairs = plan_pairs(clips, portraits, options.pairs, options.seed)
    for name in ("sheets", "sheets-swapped"):
        emptied(options.out / name)
    entries = []
    with tempfile.TemporaryDirectory() as name:
        assets = options.assets or Path(name) / "assets"
        assets.mkdir(parents=True, exist_ok=True)
        by_clip = sorted(pairs, key=lambda pair: (pair.clip, pair.number))
        for k, (clip, group) in enumerate(groupby(by_clip, key=lambda pair: pair.clip)):
            drawn = draw_clip(clip, list(group), options.against, assets)
            elsewhere = draw_at_revision(commit, drawn, Path(name) / f"revision-{k}") if commit else None
            for i, one in enumerate(drawn):
                rival = elsewhere[i] if elsewhere is not None else one.rival
                assert rival is not None
                _save(one, rival, options.out)
                entries.append(_entry(one, options.against))
            print(f"{len(entries):3d} of {len(pairs)} sheets", flush=True)
    entries.sort(key=lambda entry: entry.number)
    about = {"against": options.against, "commit": commit, "half": options.half, "seed": options.seed}
    write_key(options.out / "key" / "key.json", entries, about)
    for choices in tables:
        write_template(choices, [entry.number for entry in entries])
    print(f"sheets in {options.out}; the key, not to be looked at, in {options.out / 'key'}")


if __name__ == "__main__":
    main()
