"""`python -m benchmarks.grades`: sheets of looks with far references, some of them untouched frames, to be graded."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from benchmarks.blind.options import add_material, emptied, material_of
from benchmarks.blind.tables import check_unfilled
from benchmarks.grades.drawing import draw_clip, farthest, read_references
from benchmarks.grades.plan import plan_sheets
from benchmarks.grades.score import GRADES, Entry, write_key, write_template
from pvg.video import write_image


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.grades", description=__doc__)
    parser.add_argument("--stills", action="store_true", help="looks of the portraits themselves, without controls")
    parser.add_argument("--looks", type=int, default=6, help="a clip")
    parser.add_argument("--controls", type=int, default=1, help="a clip: frames that nobody touched, among the looks")
    parser.add_argument("--farthest", type=int, default=9, help="references, of which those of a clip are drawn")
    parser.add_argument("--place", type=float, default=0.5, help="of the frame, 0 to 1 of those with the face")
    add_material(parser, half="all", seed_of="references and order", folder="grades")
    return parser.parse_args()


def main() -> None:
    """Draw the sheets, the key and the table to fill in."""
    options = _options()
    table = options.out / "verdicts.csv"
    check_unfilled(table, GRADES)
    clips, portraits = material_of(options)
    if options.stills:  # there is no second frame to stand for a control's reference
        clips, options.controls = portraits, 0
    folder = emptied(options.out / "sheets")
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
