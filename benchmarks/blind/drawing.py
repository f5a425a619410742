"""Ours and the rival on the same clip, reference and frames."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import tarfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import pvg
from benchmarks.blind.plan import Pair
from benchmarks.quality.clips import kept_asset, measured_frames, same_face, widest
from benchmarks.quality.color import ita
from benchmarks.quality.faces import Image, Reference, View, read_reference, view_of
from benchmarks.quality.peers import (
    MK,
    PAPER,
    PAPERS_TRANSFER,
    REINHARD,
    Looks,
    Method,
    RasterTransport,
    Replayed,
    fit_mk,
    fit_reinhard,
)
from pvg.rendering import source_frame
from scripts.samples import REPOSITORY

RIVALS = ("paper", "mk", "reinhard", "omt")
_AT_REVISION = Path(__file__).with_name("at_revision.py")
_CROP = 1.9  # of the face's width, the side of a face crop


@dataclass(frozen=True, eq=False)
class DrawnPair:
    """The pictures of a sheet: one a frame of ours and of the rival, (H, W, 3) uint8 RGB, and where their faces are.

    rival is None while it is drawn elsewhere;  crops: windows of the frames;  reference: the reference's face;
    point: middle of the face in the first frame;  ita: of the clip's skin, degrees.
    """

    pair: Pair
    frames: list[int]
    ours: list[Image]
    rival: list[Image] | None
    crops: list[tuple[slice, slice]]
    reference: Image
    point: tuple[float, float]
    ita: float


def face_window(view: View) -> tuple[slice, slice]:
    """A square around the face with ears and neck, cut at the picture's edges."""
    middle = view.data.landmarks.stacked.mean(axis=0)
    half = _CROP * view.width / 2
    x0, y0 = (max(0, round(float(v - half))) for v in middle)
    x1, y1 = (min(side, round(float(v + half))) for v, side in zip(middle, view.size, strict=True))
    return slice(y0, y1), slice(x0, x1)


def _rival(
    against: str, video: pvg.VectorVideo, face: int, paper: tuple[pvg.VectorVideo, int] | None, reference: Reference
) -> Method | None:
    """The rival on a clip; None for a revision, which is drawn in a process of its own."""
    if against == "paper":
        if paper is None:
            raise ValueError(f"{video.path.name}: the chain has lost the face")
        return Looks.of(PAPER, *paper, [reference], **PAPERS_TRANSFER)
    makers: dict[str, Callable[[], Method]] = {
        "mk": lambda: Replayed(MK, [reference], fit_mk),
        "reinhard": lambda: Replayed(REINHARD, [reference], fit_reinhard),
        "omt": lambda: RasterTransport([reference]),
    }
    return makers[against]() if against in makers else None


def draw_clip(clip: Path, pairs: Sequence[Pair], against: str, assets: Path) -> list[DrawnPair]:
    """All sheets' pictures of one clip; assets are made in, or taken from, a folder."""
    with ExitStack() as stack:
        video = stack.enter_context(pvg.open_asset(kept_asset(clip, assets), clip))
        face = widest(video)
        seen = measured_frames(video, face)
        first = next(iter(seen))
        size = (video.media.width, video.media.height)
        paper = None
        if against == "paper":
            other = stack.enter_context(pvg.open_asset(kept_asset(clip, assets, paper=True), clip))
            twin = same_face(other, seen[first], first)
            paper = None if twin is None else (other, twin)
        opening = source_frame(video, first)
        start = view_of(seen[first], size)
        tone = ita(np.median(start.crop(opening.rgb())[start.bare], axis=0))
        out = []
        for pair in pairs:
            reference = read_reference(pair.reference, kept_asset(pair.reference, assets, reference=True))
            stack.callback(reference.video.close)
            ours = Looks.of("ours", video, face, [reference])
            rival = _rival(against, video, face, paper, reference)
            if isinstance(rival, Replayed):
                rival.draw(opening, start)  # where its map is fitted
            numbers = pair.frames(list(seen))
            views = [view_of(seen[number], size) for number in numbers]
            frames = [source_frame(video, number) for number in numbers]
            out.append(
                DrawnPair(
                    pair,
                    numbers,
                    [ours.draw(f, v)[0].rgb for f, v in zip(frames, views, strict=True)],
                    None if rival is None else [rival.draw(f, v)[0].rgb for f, v in zip(frames, views, strict=True)],
                    [face_window(view) for view in views],
                    reference.rgb[face_window(reference.view)],
                    tuple(float(v) for v in views[0].data.landmarks.points.mean(axis=0)),  # type: ignore[arg-type]
                    tone,
                )
            )
        return out


def revision_of(name: str) -> str:
    """The commit that a name stands for. Raises `SystemExit` when the repository has none."""
    found = subprocess.run(
        ["git", "rev-parse", "--verify", "--quiet", f"{name}^{{commit}}"],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
    )
    if found.returncode:
        raise SystemExit(f"{name!r} is neither one of {', '.join(RIVALS)} nor a revision of this repository")
    return found.stdout.strip()


def draw_at_revision(commit: str, drawn: Sequence[DrawnPair], folder: Path) -> list[list[Image]]:
    """The same frames by the library as it was at a commit, in a process of its own."""
    tree, assets = folder / "tree", folder / "assets"
    assets.mkdir(parents=True)
    packed = subprocess.run(["git", "archive", commit, "pvg"], cwd=REPOSITORY, capture_output=True, check=True).stdout
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        archive.extractall(tree, filter="data")
    outs = [folder / f"{one.pair.number}.npz" for one in drawn]
    jobs = [
        {
            "clip": str(one.pair.clip.resolve()),
            "reference": str(one.pair.reference.resolve()),
            "frames": one.frames,
            "point": one.point,
            "out": str(out),
        }
        for one, out in zip(drawn, outs, strict=True)
    ]
    work = folder / "jobs.json"
    work.write_text(json.dumps({"folder": str(assets), "jobs": jobs}))
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    subprocess.run([sys.executable, "-P", str(_AT_REVISION), str(work)], cwd=tree, env=environment, check=True)
    return [list(np.load(out)["frames"]) for out in outs]
