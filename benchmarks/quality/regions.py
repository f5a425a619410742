"""How much of each labelled region changes with the face, and what changes that should not.

`python -m benchmarks.quality.regions --half report` draws the default look on the labelled pictures and prints a table.
With `--variants` it takes one picture of each file as other cameras would have taken it, and prints what their mattes
hold of each region beside what those of the pictures as they are hold.

The face's change D is the median, over the labelled face without eyes and mouth, of after − before in CIELAB. A pixel
of skin changes with the face when the projection of its change on D is at least half of |D|; one that is no skin when
it is at least a fifth.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import pvg
from benchmarks.quality.clips import kept_asset, opened_paper
from benchmarks.quality.color import delta_e_of_labs
from benchmarks.quality.faces import (
    Bools,
    Floats,
    Image,
    Reference,
    hulls,
    odd_kernel,
    read_reference,
    references_of,
    view_of,
)
from benchmarks.quality.labels import LABELS, SKIN, Label, read_labels
from benchmarks.quality.media import HALVES, MEDIA, Half, find_material, half_of, usable_portraits
from benchmarks.quality.peers import DEEP, OURS, Looks, Method, open_methods
from benchmarks.quality.variants import PLAIN, VARIANTS, Kept, alpha_of, variants_table
from pvg.asset import FaceInFrame
from pvg.face import Landmarks, layout
from pvg.rendering import source_frame

SKIN_REGIONS = ("face", "rim", "ear", "neck", "body", "hand")
OTHER_REGIONS = ("hair", "cloth", "other", "background")
ONE_PERSON = ("neck", "ear", "hand", "body")
STRONG = ("woman_pale_soft_light", "man_brown_skin_glasses_beard_blue_bg")
_SKIN_SHARE, _OTHER_SHARE = 0.5, 0.2  # of |D|
_GROWN = 0.03  # of the face's width: eyes and mouth grow by it; the rim is as wide
_AWAY = 0.02  # of the face's width between skin and background
_GLOW_PX = (2.0, 10.0)
_LEAST_PIXELS = 30
_LEAST_CHANGE = 3.0  # |D| in CIELAB below which the face counts as unchanged
_NEAR = 0.5  # of the face's width, between a labelled face and the tracked one
UNCHANGED = "the face is not changed"
_WORST = 3

Labs = NDArray[np.float32]
LookMaker = Callable[[pvg.VectorVideo, int, Reference], Sequence[Method]]


def labs(picture: Image) -> Labs:
    """(H, W, 3) float32 CIELAB of an sRGB picture."""
    return np.asarray(cv2.cvtColor(picture.astype(np.float32) / np.float32(255), cv2.COLOR_RGB2Lab), np.float32)


def _distance_to(mask: Bools) -> Floats:
    """(H, W) pixels to the nearest pixel of a mask; large where it is empty."""
    if not mask.any():
        return np.full(mask.shape, np.inf, np.float32)
    return np.asarray(cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5), np.float32)


@dataclass(frozen=True, eq=False)
class LabelledFace:
    """Where the regions of one person lie in a labelled picture.

    masks: region -> (H, W) bool, those of too few pixels left out;  core: the face without eyes and mouth;
    skin: all labelled skin of the person;  glow: 2 to 10 px outside all skin;  wall: what of that has no label.
    """

    masks: dict[str, Bools]
    core: Bools
    skin: Bools
    glow: Bools
    wall: Bools

    @classmethod
    def of(cls, label: Label, person: int, landmarks: Landmarks) -> LabelledFace:
        """The regions of a person of whom landmarks are known."""
        width = landmarks.axes.width
        shape = (label.size[1], label.size[0])
        face = label.mask(("face",), person)
        features = (layout.LEFT_EYE, layout.RIGHT_EYE, layout.LIPS_OUTER)
        closed = hulls(shape, [landmarks.points[feature] for feature in features]).astype(np.uint8)
        core = face & ~cv2.dilate(closed, odd_kernel(_GROWN * width)).astype(np.bool_)
        every = label.mask(SKIN)
        from_skin = _distance_to(every)
        named = label.mask((*SKIN, "hair", "cloth", "other"))
        masks = {
            "face": core,
            "rim": core & (_distance_to(~face) <= _GROWN * width),
            **{kind: label.mask((kind,), person) for kind in ("ear", "neck", "body", "hand")},
            **{kind: label.mask((kind,)) for kind in ("hair", "cloth", "other")},
            "background": ~named & (from_skin > _AWAY * width),
        }
        kept = {name: mask for name, mask in masks.items() if int(mask.sum()) >= _LEAST_PIXELS}
        glow = (from_skin >= _GLOW_PX[0]) & (from_skin <= _GLOW_PX[1])
        return cls(kept, core, label.mask(SKIN, person), glow, glow & ~named)


@dataclass(frozen=True)
class RegionChange:
    """What a method does to one person of a labelled picture.

    change: |D|;  shares: region -> share of its pixels that change with the face;  delta_e: region -> CIEDE2000 between
    the region's median colour moved by D and as it came out;  glow: mean |change| 2 to 10 px outside the labelled skin
    over that inside;  wall: the same where the glow has no label, None without such pixels.
    """

    change: float
    shares: dict[str, float]
    delta_e: dict[str, float]
    glow: float
    wall: float | None

    def row(self) -> dict[str, Any]:
        """Flat, for tables."""
        deltas = {f"ΔE {name}": value for name, value in self.delta_e.items()}
        return {"D": self.change, **self.shares, **deltas, "glow": self.glow, "glow on the wall": self.wall}


def measure_regions(face: LabelledFace, before: Labs, after: Labs) -> RegionChange | None:
    """The change of each region; None when the face does not change. before, after: (H, W, 3) CIELAB."""
    change = after - before
    whole = np.median(change[face.core], axis=0)
    size = float(np.linalg.norm(whole))
    if size < _LEAST_CHANGE:
        return None
    along = change @ (whole / np.float32(size)) / np.float32(size)
    shares = {
        name: float((along[mask] >= (_SKIN_SHARE if name in SKIN_REGIONS else _OTHER_SHARE)).mean())
        for name, mask in face.masks.items()
    }
    deltas = {}
    for name in ONE_PERSON:
        if name in face.masks:
            mask = face.masks[name]
            own = np.median(before[mask], axis=0)
            deltas[name] = delta_e_of_labs(own + whole, own + np.median(change[mask], axis=0))
    length = np.linalg.norm(change, axis=2)
    inside = max(float(length[face.skin].mean()), 1e-6)
    glow, wall = (
        float(length[mask].mean()) / inside if int(mask.sum()) >= _LEAST_PIXELS else None
        for mask in (face.glow, face.wall)
    )
    return RegionChange(size, shares, deltas, glow or 0.0, wall)


def tracked_face(video: pvg.VectorVideo, label: Label, person: int) -> tuple[int, FaceInFrame] | None:
    """The face of an asset that lies on a person's labelled face."""
    ys, xs = np.nonzero(label.mask(("face",), person))
    if not len(xs):
        return None
    middle = np.array([np.median(xs), np.median(ys)])
    best: tuple[float, int, FaceInFrame] | None = None
    for face in video.faces:
        data = video.face_at(face.index, label.frame)
        if data is None or data.score <= 0:
            continue
        away = float(np.linalg.norm(data.landmarks.axes.center - middle)) / data.landmarks.axes.width
        if away < _NEAR and (best is None or away < best[0]):
            best = (away, face.index, data)
    return None if best is None else (best[1], best[2])


def default_look(video: pvg.VectorVideo, face: int, reference: Reference) -> list[Method]:
    """Ours with its defaults."""
    return [Looks.of(OURS[0], video, face, [reference])]


def label_rows(
    label: Label, video: pvg.VectorVideo, references: Sequence[Reference], make: LookMaker = default_look
) -> tuple[list[dict[str, Any]], list[str]]:
    """A row for each person and method, with the reference that changes the face most; and who is left out, and why."""
    frame = source_frame(video, label.frame)
    before = labs(frame.rgb())
    rows, left_out = [], []
    for person in label.persons:
        name = f"{label.name}, person {person}" if len(label.persons) > 1 else label.name
        found = tracked_face(video, label, person)
        if found is None:
            left_out.append(f"{name}: no tracked face")
            continue
        face, data = found
        where = LabelledFace.of(label, person, data.landmarks)
        view = view_of(data, (frame.width, frame.height))
        middle = np.median(before[where.core], axis=0)
        strongest: tuple[float, Reference] | None = None
        for reference in references:
            (drawn,) = Looks.of(OURS[0], video, face, [reference]).draw(frame, view)
            moved = delta_e_of_labs(middle, np.median(labs(drawn.rgb)[where.core], axis=0))
            if strongest is None or moved > strongest[0]:
                strongest = (moved, reference)
        if strongest is None:
            continue
        reference = strongest[1]
        for method in make(video, face, reference):
            changed = measure_regions(where, before, labs(method.draw(frame, view)[0].rgb))
            if changed is None:
                left_out.append(f"{name}, {method.name}: {UNCHANGED}")
                continue
            rows.append({"picture": name, "reference": reference.name, "method": method.name, **changed.row()})
    return rows, left_out


def run_regions(
    media: Path, labels: Sequence[Label], asset: Path, paper_asset: Path, references: dict[Path, Path]
) -> dict[str, Any]:
    """All methods on the labels of one clip or still, which is vectorised unless its asset is there."""
    cv2.setNumThreads(1)
    with ExitStack() as stack:
        opened = stack.enter_context(references_of(references))
        if not asset.exists():
            try:
                pvg.vectorize(media, asset=asset).close()
            except pvg.PvgError as error:
                return {"rows": [], "left_out": [f"{media.stem}: {error}"]}
        video = stack.enter_context(pvg.open_asset(asset, media))

        def every(of: pvg.VectorVideo, face: int, reference: Reference) -> list[Method]:
            # maps that are replayed are fitted on the labelled frame
            frame = labels[0].frame
            data = of.face_at(face, frame)
            paper = None if data is None else opened_paper(stack, paper_asset, media, data, frame)
            return [method for method in open_methods(of, face, paper, [reference]) if method.name != DEEP]

        rows: list[dict[str, Any]] = []
        left_out: list[str] = []
        for label in labels:
            found, missed = label_rows(label, video, opened, every)
            rows, left_out = rows + found, left_out + missed
    return {"rows": rows, "left_out": left_out}


COLUMNS = (*SKIN_REGIONS, *OTHER_REGIONS, *(f"ΔE {name}" for name in ONE_PERSON), "glow", "glow on the wall")


def _cell(name: str, value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.2f}" if name.startswith("ΔE") else f"{100 * value:.1f}"


def regions_table(rows: list[dict[str, Any]]) -> str:
    """The table of one method's rows with their means, and the worst three of each column: Markdown."""
    head = ["picture", "reference", "D", *COLUMNS]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for row in rows:
        cells = [row["picture"], row["reference"], f"{row['D']:.1f}", *(_cell(c, row.get(c)) for c in COLUMNS)]
        lines.append("| " + " | ".join(cells) + " |")
    means = {c: [row[c] for row in rows if row.get(c) is not None] for c in COLUMNS}
    averages = [_cell(c, float(np.mean(values)) if values else None) for c, values in means.items()]
    lines += ["| " + " | ".join(["**mean**", "", "", *averages]) + " |", "", "Worst:", ""]
    for column in COLUMNS:
        ranked = sorted(
            (row for row in rows if row.get(column) is not None),
            key=lambda row, c=column: row[c],  # type: ignore[misc]
            reverse=column not in SKIN_REGIONS,
        )
        if ranked:
            worst = ", ".join(f"{row['picture']} ({_cell(column, row[column])})" for row in ranked[:_WORST])
            lines.append(f"- {column}: {worst}")
    return "\n".join(lines)


def variant_rows(label: Label, folder: Path) -> tuple[list[Kept], list[str]]:
    """What the mattes hold of each person in a labelled picture's variants, and what was left out, and why.

    folder: for the pictures. Skin is held with an alpha of ½, what is none with a fifth.
    """
    picture, still = label.picture(), replace(label, frame=0)
    people: dict[int, LabelledFace] = {}
    rows, left_out = [], []
    for name, variant in VARIANTS.items():
        path = folder / f"{label.name}.png"
        cv2.imwrite(str(path), cv2.cvtColor(variant.draw(picture), cv2.COLOR_RGB2BGR))
        try:
            video = pvg.vectorize(path)
        except pvg.PvgError as error:
            left_out.append(f"{label.name}, {name}: {error}")
            continue
        with video:
            alpha = alpha_of(video, variant, label.size)
            if name == PLAIN:
                tracked = {person: tracked_face(video, still, person) for person in label.persons}
                people = {k: LabelledFace.of(label, k, one[1].landmarks) for k, one in tracked.items() if one}
        for person, where in people.items():
            held = {
                region: float((alpha[mask] >= (_SKIN_SHARE if region in SKIN_REGIONS else _OTHER_SHARE)).mean())
                for region, mask in where.masks.items()
            }
            rows.append(Kept(f"{label.name}, person {person}" if len(people) > 1 else label.name, name, held))
    return rows, left_out


def print_variants(labels: Sequence[Label]) -> None:
    """Print the table of variants of the first labelled picture of each file."""
    found: list[Kept] = []
    left_out: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        for label in {label.media: label for label in reversed(labels)}.values():
            rows, missed = variant_rows(label, Path(folder))
            found, left_out = found + rows, left_out + missed
            print(f"{label.name}: {len(rows)} mattes", flush=True)
    print("\n" + variants_table(found, SKIN_REGIONS, OTHER_REGIONS))
    print("\n".join(("", "Left out:", *left_out)) if left_out else "")


def labels_of_half(labels: Sequence[Label], half: Half) -> list[Label]:
    """The labels of the clips and portraits of one half."""
    material = find_material()
    files = (sorted(material.clips), usable_portraits(material.portraits))
    chosen = {path.name for some in files for path in half_of(some, half)}
    return [label for label in labels if half == "all" or label.media.name in chosen]


def strong_references(folder: Path, stack: ExitStack) -> list[Reference]:
    """A pale and a brown portrait, open until the stack is closed."""
    paths = [path for path in find_material().portraits if path.stem in STRONG] or list(find_material().portraits[:2])
    opened = [read_reference(path, kept_asset(path, folder, reference=True)) for path in paths]
    for reference in opened:
        stack.callback(reference.video.close)
    return opened


def main() -> None:
    """Print the table of the default look."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.quality.regions", description=__doc__)
    parser.add_argument("--half", choices=HALVES, default="all", help="every second clip and portrait, or all")
    parser.add_argument("--labels", type=Path, default=LABELS, help="folder of the label files")
    parser.add_argument("--only", default="", help="part of the labels' names")
    parser.add_argument("--assets", type=Path, help="folder that keeps the assets of this version for the next run")
    parser.add_argument("--variants", action="store_true", help="mattes of the pictures as other cameras take them")
    options = parser.parse_args()
    labels = [one for one in labels_of_half(read_labels(options.labels), options.half) if options.only in one.name]
    if options.variants:
        print_variants(labels)
        return
    rows: list[dict[str, Any]] = []
    left_out: list[str] = []
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = options.assets or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        references = strong_references(folder, stack) if labels else []
        for label in labels:
            path = MEDIA / label.media
            try:
                asset = kept_asset(path, folder)
            except pvg.PvgError as error:
                left_out.append(f"{label.name}: {error}")
                continue
            with pvg.open_asset(asset, path) as video:
                found, missed = label_rows(label, video, references)
            rows, left_out = rows + found, left_out + missed
            print(f"{label.name}: {len(found)} of {len(label.persons)} people", flush=True)
    print("\n" + (regions_table(rows) if rows else f"no label of this half in {options.labels}"))
    print("\n".join(("", "Left out:", *left_out)) if left_out else "")


if __name__ == "__main__":
    main()
