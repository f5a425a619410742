"""`python -m benchmarks.grades`: sheets of looks with far references, some of them untouched frames, to be graded."""

from __future__ import annotations

import argparse
import csv
import tempfile
from pathlib import Path

from benchmarks.grades.drawing import draw_clip, farthest, read_references
from benchmarks.grades.plan import plan_sheets
from benchmarks.grades.score import Entry, write_key, write_template
from benchmarks.quality.media import HALVES, choose, find_material, half_of, usable_portraits
from pvg.video import write_image
from scripts.samples import REPOSITORY


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.grades", description=__doc__)
    parser.add_argument("--looks", type=int, default=6, help="a clip")
    parser.add_argument("--controls", type=int, default=1, help="a clip: frames that nobody touched, among the looks")
    parser.add_argument("--farthest", type=int, default=9, help="references, of which those of a clip are drawn")
    parser.add_argument("--place", type=float, default=0.5, help="of the frame, 0 to 1 of those with the face")
    parser.add_argument("--half", choices=HALVES, default="all", help="every second clip and portrait, or all")
    parser.add_argument("--seed", type=int, default=0, help="of references and order")
    parser.add_argument("--clips", help="comma-separated parts of clip names, of that half")
    parser.add_argument("--out", type=Path, default=REPOSITORY / "benchmarks" / "out" / "grades", help="folder")
    parser.add_argument("--assets", type=Path, help="folder that keeps the assets for the next set of sheets")
    return parser.parse_args()


def main() -> None:
    """Draw the sheets, the key and the table to fill in."""
    options = _options()
    table = options.out / "verdicts.csv"
    if table.exists() and any(row["verdict"] for row in csv.DictReader(table.read_text().splitlines())):
        raise SystemExit(f"{table} is filled in; move it away or take another folder with --out")
    material = find_material()
    clips = choose(half_of(sorted(material.clips), options.half), options.clips)
    portraits = half_of(usable_portraits(material.portraits), options.half)
    folder = options.out / "sheets"
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("*.png"):
        old.unlink()
    entries: list[Entry] = []
    with tempfile.TemporaryDirectory() as name:
        assets = options.assets or Path(name)
        assets.mkdir(parents=True, exist_ok=True)
        references = read_references(portraits, assets)
        far = {clip: farthest(clip, references, options.farthest, assets) for clip in clips}
        sheets = plan_sheets(far, options.looks, options.controls, options.seed)
        for clip in clips:
            own = [sheet for sheet in sheets if sheet.clip == clip]
            for sheet, frame, picture in draw_clip(clip, own, options.place, references, assets):
                write_image(folder / f"{sheet.number:03d}.png", picture)
                entries.append(Entry(sheet.number, clip.stem, sheet.reference.stem, frame, sheet.control))
            print(f"{len(entries):3d} of {len(sheets)} sheets", flush=True)
        for reference in references.values():
            reference.video.close()
    entries.sort(key=lambda entry: entry.number)
    write_key(options.out / "key" / "key.json", entries, {"seed": options.seed, "place": options.place})
    write_template(table, [entry.number for entry in entries])
    print(f"sheets in {folder}; the key, not to be looked at, in {options.out / 'key'}")


if __name__ == "__main__":
    main()
