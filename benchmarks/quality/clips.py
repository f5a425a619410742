"""One clip with every method and reference: the measures over time and the colours reached."""

from __future__ import annotations

from collections import defaultdict
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import pvg
from benchmarks.quality.color import ita
from benchmarks.quality.faces import Bools, Floats, Image, Reference, View, references_of, view_of, window_of
from benchmarks.quality.measures import (
    Motion,
    color_distance,
    detail_kept,
    median_delta_e,
    motion,
    psnr,
    warping_errors,
)
from benchmarks.quality.peers import DEEP, Drawn, Method, method_names, open_methods
from benchmarks.quality.sheets import save_strip
from pvg.asset import FaceInFrame
from pvg.video import Frame, read_frames

COSTLY_PAIRS = 6  # pairs of neighbouring frames that costly methods are drawn on
PLACES = ("warping_whole", "warping_face", "warping_inner")  # the picture; the grown face; the shrunk face
_DETAIL_EVERY = 4
_COLOR_FRAMES = 3


@dataclass(frozen=True)
class ClipJob:
    """What a worker needs to measure one clip; assets are files, so that it travels between processes."""

    clip: Path
    asset: Path
    paper_asset: Path
    references: dict[Path, Path]
    portraits: dict[Path, Path]
    frames: int
    strips: Path


@dataclass
class Series:
    """What gathers over the frames of one (method, reference)."""

    psnr_whole: list[float] = field(default_factory=list)
    psnr_face: list[float] = field(default_factory=list)
    step_in: list[float] = field(default_factory=list)
    step_out: list[float] = field(default_factory=list)
    warp_in: list[tuple[float, ...]] = field(default_factory=list)  # over each of PLACES
    warp_out: list[tuple[float, ...]] = field(default_factory=list)
    detail: list[float] = field(default_factory=list)
    color: list[dict[str, float]] = field(default_factory=list)

    def summary(self) -> dict[str, Any]:
        """The measures of the case."""
        return {
            "steady_whole": float(np.std(self.psnr_whole)),
            "steady_face": float(np.std(self.psnr_face)),
            "step_gap": float(np.mean(self.step_in) - np.mean(self.step_out)) if self.step_in else None,
            **self._warping(),
            "detail": float(np.nanmean(self.detail)),
            **{key: float(np.mean([other[key] for other in self.color])) for row in self.color[:1] for key in row},
            "psnr_whole": [round(v, 3) for v in self.psnr_whole],
            "frames": len(self.psnr_whole),
        }

    def _warping(self) -> dict[str, float | None]:
        """Warping error of the result over that of the input, and how much larger it is about the face."""
        if not self.warp_in:
            return dict.fromkeys([*PLACES, "warp_excess", "warp_input"])
        source, result = (np.nanmean(np.array(rows), axis=0) for rows in (self.warp_in, self.warp_out))
        ratios = {name: float(result[k] / max(source[k], 1e-9)) for k, name in enumerate(PLACES)}
        around = PLACES.index("warping_face")
        return {
            **ratios,
            "warp_excess": float(result[around] - source[around]),
            "warp_input": float(source[around]),
        }


def strip_columns() -> tuple[str, ...]:
    """What a strip shows, from left to right."""
    return ("input", *(name for name in method_names() if name != DEEP), "reference")


def vectorize_clip(clip: Path, asset: Path, *, paper: bool) -> str | None:
    """Write the clip's asset, ours or with the paper's chain and its resets; returns what went wrong."""
    options: dict[str, Any] = {"matching": "chain"} if paper else {}
    try:
        pvg.vectorize(clip, asset=asset, **options).close()
    except (pvg.PvgError, ValueError) as error:
        if not paper:
            raise
        return f"{type(error).__name__}: {error}"
    return None


def kept_asset(path: Path, folder: Path, *, paper: bool = False, reference: bool = False) -> Path:
    """The asset of a clip or reference in a folder, made unless it is there."""
    asset = folder / f"{path.stem}{'.paper' * paper}{'.reference' * reference}.pvg"
    if not asset.exists():
        if reference:
            pvg.vectorize(path, asset=asset, reference=True).close()
        else:
            vectorize_clip(path, asset, paper=paper)
    return asset


def widest(video: pvg.VectorVideo) -> int:
    """The number of the widest face."""
    return max(video.faces, key=lambda face: face.width_px).index


def same_face(paper: pvg.VectorVideo, data: FaceInFrame, frame: int) -> int | None:
    """The face of another asset of the same clip that lies on `data` in `frame`."""
    own = data.landmarks.points
    best, nearest = None, float("inf")
    for face in paper.faces:
        other = paper.face_at(face.index, frame)
        if other is None:
            continue
        distance = float(np.linalg.norm(other.landmarks.points.mean(axis=0) - own.mean(axis=0)))
        if distance < nearest:
            best, nearest = face.index, distance
    return best if nearest < 0.3 * float(np.ptp(own[:, 0])) else None


@dataclass(frozen=True, eq=False)
class _Moment:
    """A measured frame's source and results, whole pictures, for the next one to be compared with."""

    index: int
    source: Image
    results: dict[str, list[Image]]


@dataclass(frozen=True, eq=False)
class _Step:
    """From the frame before to this one: its motion, where it is looked at, and what the source itself measures."""

    before: _Moment
    moved: Motion
    places: tuple[Bools | None, ...]
    errors: tuple[float, ...]
    psnr: float

    @classmethod
    def between(cls, before: _Moment, source: Image, view: View) -> _Step:
        """The step to a picture from the moment before."""
        moved = motion(before.source, source)
        places = (None, *(view.over_picture(mask) for mask in (view.around, view.inner)))
        errors = tuple(warping_errors(before.source, source, moved, places))
        return cls(before, moved, places, errors, psnr(view.crop(before.source), view.crop(source)))

    def add(self, series: Series, was: Image, result: Image, view: View) -> None:
        """Add a result's warping errors and step to its series."""
        series.warp_in.append(self.errors)
        series.warp_out.append(tuple(warping_errors(was, result, self.moved, self.places)))
        series.step_in.append(self.psnr)
        series.step_out.append(psnr(view.crop(was), view.crop(result)))


class _ClipRun:
    """The measures of one clip while its frames stream past."""

    def __init__(self, methods: list[Method], references: list[Reference], measured: list[int]) -> None:
        self._methods = methods
        self._references = references
        self._measured = measured
        starts = np.linspace(0, max(0, len(measured) - 2), COSTLY_PAIRS).astype(int)
        self._pairs = {measured[min(int(s) + k, len(measured) - 1)] for s in starts for k in (0, 1)}
        looked_at = np.linspace(0, len(measured) - 1, _COLOR_FRAMES).astype(int)
        # colours are looked at in frames that costly methods draw too
        ordered = sorted(self._pairs)
        self._color_frames = {min(ordered, key=lambda f: abs(f - measured[int(i)])) for i in looked_at}
        self._before: _Moment | None = None
        self.series: dict[tuple[str, str], Series] = defaultdict(Series)
        self.strips: dict[str, dict[str, Image]] = {}

    def add(self, frame: Frame, view: View) -> None:
        """Draw and measure one frame."""
        source = frame.rgb()
        luma = _luma(frame, view)
        follows = self._before is not None and self._before.index == frame.index - 1
        step = _Step.between(self._before, source, view) if follows and self._before is not None else None
        results: dict[str, list[Image]] = {}
        for method in self._methods:
            if method.costly and frame.index not in self._pairs:
                continue
            pictures = method.draw(frame, view)
            results[method.name] = [picture.rgb for picture in pictures]
            for k, (reference, picture) in enumerate(zip(self._references, pictures, strict=True)):
                series = self.series[method.name, reference.name]
                self._measure_frame(series, frame, view, luma, picture, reference)
                if step is not None and method.name in step.before.results:
                    step.add(series, step.before.results[method.name][k], picture.rgb, view)
        if frame.index == min(self._color_frames, key=lambda f: abs(f - self._measured[len(self._measured) // 2])):
            for k, reference in enumerate(self._references):
                shown = {name: view.crop(pictures[k]) for name, pictures in results.items()}
                part = reference.view.crop(reference.rgb)
                self.strips[reference.name] = {"input": view.crop(source), **shown, "reference": part}
        self._before = _Moment(frame.index, source, results)

    def _measure_frame(
        self, series: Series, frame: Frame, view: View, luma: Floats, picture: Drawn, reference: Reference
    ) -> None:
        rgb = frame.rgb()
        series.psnr_whole.append(psnr(rgb, picture.rgb))
        source, result = view.crop(rgb), view.crop(picture.rgb)
        if view.face.any():
            series.psnr_face.append(psnr(source, result, view.face))
        nth = self._measured.index(frame.index)
        if (nth % _DETAIL_EVERY == 0 or frame.index in self._color_frames) and view.inner.any():
            series.detail.append(detail_kept(luma, picture.luma(frame, view.window), view.inner))
        if frame.index in self._color_frames and view.bare.any():
            series.color.append(measure_color(source, result, view, reference))


def _luma(frame: Frame, view: View) -> Floats:
    plane = None if frame.format.is_rgb else frame.planes[0]
    return Drawn(frame.rgb(), plane).luma(frame, view.window)


def measure_color(before: Image, after: Image, view: View, reference: Reference) -> dict[str, float]:
    """Distances of face skin to the reference's, before and after: of all open skin, and of that above the nose's base.

    before, after: (h, w, 3) the source and a result over the view's window.
    """
    out: dict[str, float] = {}
    for where, wanted, suffix in ((view.skin, reference.skin, ""), (view.bare, reference.bare, "_upper")):
        median = np.median(wanted, axis=0)
        for picture, stage in ((before, "_before"), (after, "")):
            out["distance" + stage + suffix] = color_distance(picture[where], wanted)
            out["delta_e" + stage + suffix] = median_delta_e(picture[where], median)
    return out


def measured_frames(video: pvg.VectorVideo, face: int, count: int | None = None) -> dict[int, FaceInFrame]:
    """The frames in which the face is seen, all or the first `count`."""
    summary = video.faces[face]
    out: dict[int, FaceInFrame] = {}
    for index in range(summary.first_frame, summary.last_frame + 1):
        data = video.face_at(face, index)
        if data is not None and data.score > 0 and data.matte.mask.any():
            out[index] = data
        if len(out) == count:
            break
    return out


def run_clip(job: ClipJob) -> dict[str, Any]:
    """Measure one clip: cases (method x reference) over time, and colours for all portraits."""
    cv2.setNumThreads(1)
    with ExitStack() as stack:
        references = stack.enter_context(references_of(job.references))
        portraits = stack.enter_context(references_of(job.portraits))
        video = stack.enter_context(pvg.open_asset(job.asset, job.clip))
        face = widest(video)
        seen = measured_frames(video, face, job.frames)
        first = next(iter(seen))
        size = (video.media.width, video.media.height)
        paper: tuple[pvg.VectorVideo, int] | None = None
        if job.paper_asset.exists():
            other = stack.enter_context(pvg.open_asset(job.paper_asset, job.clip))
            twin = same_face(other, seen[first], first)
            paper = None if twin is None else (other, twin)
        window = window_of(list(seen.values()), size)
        run = _ClipRun(open_methods(video, face, paper, references), references, list(seen))
        tone: Floats | None = None
        colors: list[dict[str, Any]] = []
        for frame in read_frames(job.clip, start=first, stop=max(seen) + 1):
            if frame.index not in seen:
                continue
            view = view_of(seen[frame.index], size, window)
            if tone is None and view.bare.any():
                tone = np.median(view.crop(frame.rgb())[view.bare], axis=0)
                methods = open_methods(video, face, paper, portraits)
                colors = _all_portraits(job, methods, frame, view, portraits)
            run.add(frame, view)
        for reference in references:
            path = job.strips / f"{job.clip.stem}--{reference.name}.jpg"
            save_strip(path, strip_columns(), run.strips[reference.name])
        cases = [
            {"clip": job.clip.stem, "method": m, "reference": r, "reference_ita": _ita_of(references, r), **s.summary()}
            for (m, r), s in run.series.items()
        ]
        return {
            "clip": job.clip.stem,
            "ita": ita(tone),
            "frames": len(seen),
            "cases": cases,
            "colors": colors,
            "paper": paper is not None,
        }


def _ita_of(references: list[Reference], name: str) -> float:
    return next(reference.ita for reference in references if reference.name == name)


def _all_portraits(
    job: ClipJob, methods: list[Method], frame: Frame, view: View, portraits: list[Reference]
) -> list[dict[str, Any]]:
    """The colours that every method reaches in one frame, for every portrait."""
    source = view.crop(frame.rgb())
    rows = []
    strips: dict[str, dict[str, Image]] = {
        portrait.name: {"input": source, "reference": portrait.view.crop(portrait.rgb)} for portrait in portraits
    }
    for method in methods:
        if method.name == DEEP:
            continue
        for portrait, picture in zip(portraits, method.draw(frame, view), strict=True):
            result = view.crop(picture.rgb)
            strips[portrait.name][method.name] = result
            rows.append(
                {
                    "clip": job.clip.stem,
                    "reference": portrait.name,
                    "reference_ita": portrait.ita,
                    "method": method.name,
                    **measure_color(source, result, view, portrait),
                }
            )
    for portrait in portraits:
        path = job.strips / f"{job.clip.stem}--{portrait.name}--color.jpg"
        save_strip(path, strip_columns(), strips[portrait.name])
    return rows
