"""One clip with every method: the measures over time on all its frames, and the colours reached with every portrait."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import pvg
from benchmarks.quality.carried import Described, carried_row, describe
from benchmarks.quality.color import ita
from benchmarks.quality.faces import Bools, Floats, Image, Reference, View, references_of, view_of, window_of
from benchmarks.quality.measures import (
    Motion,
    color_distance,
    detail_kept,
    less_running_mean,
    median_delta_e,
    motion,
    psnr,
    warping_errors,
)
from benchmarks.quality.peers import DEEP, Drawn, Method, method_names, open_methods
from benchmarks.quality.sheets import save_strip
from pvg.asset import FaceInFrame
from pvg.video import Frame, read_frames

MOTION_PAIRS = 30  # neighbouring frames that warping errors are measured on, spread over the clip
COSTLY_FRAMES = 13  # consecutive frames in the middle of the clip that costly methods are drawn on
PLACES = ("warping_whole", "warping_face", "warping_inner")  # the picture; the grown face; the shrunk face
COLOR_FRAMES = 3
_DETAIL_FRAMES = 10
_COSTLY_DETAIL_EVERY = 4


@dataclass(frozen=True)
class ClipJob:
    """What a worker needs to measure one clip; assets are files, so that it travels between processes.

    references: of the measures over time, costly methods take the first;  frames: at most so many, all when None.
    """

    clip: Path
    asset: Path
    paper_asset: Path
    references: dict[Path, Path]
    portraits: dict[Path, Path]
    frames: int | None
    strips: Path


@dataclass
class Series:
    """What gathers over the frames of one (method, reference)."""

    frames: list[int] = field(default_factory=list)
    psnr_whole: list[float] = field(default_factory=list)
    psnr_face: list[float] = field(default_factory=list)
    warp_in: list[tuple[float, ...]] = field(default_factory=list)  # over each of PLACES
    warp_out: list[tuple[float, ...]] = field(default_factory=list)
    detail: list[float] = field(default_factory=list)

    def summary(self, shots: Sequence[int], frame_rate: float) -> dict[str, Any]:
        """The measures of the case; shots: first frames of the clip's shots."""
        breaks = [
            later != earlier + 1 or later in shots for earlier, later in zip(self.frames, self.frames[1:], strict=False)
        ]
        second = max(1, round(frame_rate))
        steady = {
            name: float(np.std(less_running_mean(values, [False, *breaks], second)))
            for name, values in (("steady_whole", self.psnr_whole), ("steady_face", self.psnr_face))
        }
        return {
            **steady,
            "raw_whole": float(np.std(self.psnr_whole)),
            "raw_face": float(np.std(self.psnr_face)),
            **self._warping(),
            "detail": float(np.nanmean(self.detail)) if self.detail else None,
            "first": self.frames[0],
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


PaperVideo = tuple[pvg.VectorVideo, int]
"""An asset with the paper's chain, and the number of the face in it."""


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
    """A frame's source and results, whole pictures, for the next one to be compared with."""

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

    @classmethod
    def between(cls, before: _Moment, source: Image, view: View) -> _Step:
        """The step to a picture from the moment before."""
        moved = motion(before.source, source)
        places = (None, *(view.over_picture(mask) for mask in (view.around, view.inner)))
        return cls(before, moved, places, tuple(warping_errors(before.source, source, moved, places)))

    def add(self, series: Series, was: Image, result: Image) -> None:
        """Add a result's warping errors to its series."""
        series.warp_in.append(self.errors)
        series.warp_out.append(tuple(warping_errors(was, result, self.moved, self.places)))


def spread(items: Sequence[int], count: int) -> set[int]:
    """At most `count` of them, evenly, with both ends."""
    return {items[int(i)] for i in np.rint(np.linspace(0, len(items) - 1, min(count, len(items))))}


class _OverTime:
    """The measures over time of one clip while its frames stream past."""

    def __init__(self, methods: list[Method], references: list[Reference], seen: list[int]) -> None:
        self._methods = methods
        self._references = references
        middle = max(0, (len(seen) - COSTLY_FRAMES) // 2)
        self._costly = seen[middle : middle + COSTLY_FRAMES]
        follows = [later for earlier, later in itertools.pairwise(seen) if later == earlier + 1]
        self._pairs = (spread(follows, MOTION_PAIRS) if follows else set()) | (set(self._costly[1:]) & set(follows))
        self._detail = spread(seen, _DETAIL_FRAMES)
        self._before: _Moment | None = None
        self.series: dict[tuple[str, str], Series] = defaultdict(Series)

    def add(self, frame: Frame, view: View) -> None:
        """Draw and measure one frame."""
        source = frame.rgb()
        step = None
        if frame.index in self._pairs and self._before is not None and self._before.index == frame.index - 1:
            step = _Step.between(self._before, source, view)
        results: dict[str, list[Image]] = {}
        for method in self._methods:
            if method.costly and frame.index not in self._costly:
                continue
            pictures = method.draw(frame, view)
            results[method.name] = [picture.rgb for picture in pictures]
            # costly methods are open for the first reference only
            for k, (reference, picture) in enumerate(zip(self._references, pictures, strict=False)):
                series = self.series[method.name, reference.name]
                self._measure(series, method, frame, view, picture)
                if step is not None and method.name in step.before.results:
                    step.add(series, step.before.results[method.name][k], picture.rgb)
        self._before = _Moment(frame.index, source, results) if frame.index + 1 in self._pairs else None

    def _measure(self, series: Series, method: Method, frame: Frame, view: View, picture: Drawn) -> None:
        rgb = frame.rgb()
        series.frames.append(frame.index)
        series.psnr_whole.append(psnr(rgb, picture.rgb))
        where = view.face if view.face.any() else None
        series.psnr_face.append(psnr(view.crop(rgb), view.crop(picture.rgb), where))
        detailed = frame.index in self._detail
        if method.costly:
            detailed = (frame.index - self._costly[0]) % _COSTLY_DETAIL_EVERY == 0
        if detailed and view.inner.any():
            luma = Drawn(rgb, None if frame.format.is_rgb else frame.planes[0]).luma(frame, view.window)
            series.detail.append(detail_kept(luma, picture.luma(frame, view.window), view.inner))


def measure_color(part: Image, view: View, reference: Reference) -> tuple[float, float]:
    """Distance of open face skin to the reference's, and CIEDE2000 of the medians; part: (h, w, 3) in the window."""
    pixels = part[view.skin]
    return color_distance(pixels, reference.skin), median_delta_e(pixels, np.median(reference.skin, axis=0))


class _Colors:
    """What every method reaches with every portrait, in a few frames of a clip; costly methods in the first of them."""

    def __init__(self, job: ClipJob, methods: list[Method], portraits: list[Reference]) -> None:
        self._job = job
        self._methods = methods
        self._portraits = portraits
        self._wanted: list[Described] = [
            describe(portrait.view.crop(portrait.rgb), portrait.view) for portrait in portraits
        ]
        self.rows: list[dict[str, Any]] = []

    def add(self, frame: Frame, view: View) -> None:
        """Draw and measure one frame."""
        source = view.crop(frame.rgb())
        first = not self.rows
        before = describe(source, view)
        away = {portrait.name: measure_color(source, view, portrait) for portrait in self._portraits}
        strips: dict[str, dict[str, Image]] = {
            portrait.name: {"input": source, "reference": portrait.view.crop(portrait.rgb)}
            for portrait in self._portraits
        }
        for method in self._methods:
            if method.name == DEEP or (method.costly and not first):
                continue
            pictures = method.draw(frame, view)
            for portrait, wanted, picture in zip(self._portraits, self._wanted, pictures, strict=True):
                result = view.crop(picture.rgb)
                strips[portrait.name][method.name] = result
                distance, delta_e = measure_color(result, view, portrait)
                self.rows.append(
                    {
                        "clip": self._job.clip.stem,
                        "frame": frame.index,
                        "reference": portrait.name,
                        "reference_ita": portrait.ita,
                        "reference_bearded": portrait.view.bearded,
                        "method": method.name,
                        "distance_before": away[portrait.name][0],
                        "delta_e_before": away[portrait.name][1],
                        "distance": distance,
                        "delta_e": delta_e,
                        **carried_row(before, describe(result, view), wanted),
                    }
                )
        if first:
            for portrait in self._portraits:
                path = self._job.strips / f"{self._job.clip.stem}--{portrait.name}.jpg"
                save_strip(path, strip_columns(), strips[portrait.name])


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


def opened_paper(stack: ExitStack, job_asset: Path, clip: Path, data: FaceInFrame, frame: int) -> PaperVideo | None:
    """The clip's asset with the paper's chain, and its face that lies on `data` in `frame`."""
    if not job_asset.exists():
        return None
    video = stack.enter_context(pvg.open_asset(job_asset, clip))
    twin = same_face(video, data, frame)
    return None if twin is None else (video, twin)


def run_clip(job: ClipJob) -> dict[str, Any]:
    """Measure one clip: cases (method x reference) over time, and colours for all portraits."""
    cv2.setNumThreads(1)
    with ExitStack() as stack:
        references = stack.enter_context(references_of(job.references))
        portraits = stack.enter_context(references_of(job.portraits))
        video = stack.enter_context(pvg.open_asset(job.asset, job.clip))
        face = widest(video)
        seen = measured_frames(video, face, job.frames)
        numbers = list(seen)
        size = (video.media.width, video.media.height)
        paper = opened_paper(stack, job.paper_asset, job.clip, seen[numbers[0]], numbers[0])
        methods = [m for m in open_methods(video, face, paper, references) if not m.costly]
        methods += [m for m in open_methods(video, face, None, references[:1]) if m.costly]
        over_time = _OverTime(methods, references, numbers)
        colors = _Colors(job, open_methods(video, face, paper, portraits, full=True), portraits)
        color_frames = spread(numbers, COLOR_FRAMES)
        window = window_of(list(seen.values()), size)
        tone: Floats | None = None
        for frame in read_frames(job.clip, start=numbers[0], stop=numbers[-1] + 1):
            if frame.index not in seen:
                continue
            view = view_of(seen[frame.index], size, window)
            if frame.index in color_frames and view.bare.any():
                if tone is None:
                    tone = np.median(view.crop(frame.rgb())[view.bare], axis=0)
                colors.add(frame, view_of(seen[frame.index], size).looked_at(frame.rgb()))
            over_time.add(frame, view)
        rate = video.media.frame_rate or 25.0
        cases = [
            {
                "clip": job.clip.stem,
                "method": method,
                "reference": name,
                "reference_ita": next(one.ita for one in references if one.name == name),
                **series.summary(video.shots, rate),
            }
            for (method, name), series in over_time.series.items()
        ]
        return {
            "clip": job.clip.stem,
            "ita": ita(tone),
            "frames": len(seen),
            "cases": cases,
            "colors": colors.rows,
            "paper": paper is not None,
        }
