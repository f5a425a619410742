"""The sections of the speed benchmark, one after the other on the same material."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import pvg
from benchmarks.alone import run_alone
from benchmarks.clips import Material, make_clip
from benchmarks.growth import clip_windows, cost_times, face_windows, over_frames, over_looks, over_sizes
from benchmarks.membrane import membrane_times
from benchmarks.rivals import PLAIN_OMT, rival_times
from benchmarks.runs import Job, color_transfer, references, single_frames, transfer_clip, vectorize_clip, whole_runs
from benchmarks.service_run import over_http
from benchmarks.stages import stage_times
from benchmarks.targets import FRAMES, LOOKS
from pvg.video import probe, read_frames

SECTIONS = ("membrane", "stages", "runs", "single", "rivals", "memory", "growth", "sizes", "http")
"""Methods of `Suite`, in the order they run."""

CLOSE_UP_PX = 800  # a face as wide as the paper's


@dataclass(frozen=True)
class Effort:
    """How much is measured."""

    clip_frames: int
    rounds: int
    portraits: int
    random_frames: int
    stage_frames: int
    rival_frames: int
    close_up_frames: int
    membranes: int
    frame_counts: tuple[int, ...]
    look_counts: tuple[int, ...]
    look_frames: int
    faces: tuple[int, ...]
    clips: tuple[float, ...]
    size_frames: tuple[int, int]  # length of the clips, frames measured
    in_full: bool  # 600 frames and 10 looks really run, and the service asked


FULL = Effort(
    *(240, 3, 4, 40, 24, 8, 48, 40),
    frame_counts=(75, 150, 300, 600),
    look_counts=(1, 2, 4, 8),
    look_frames=150,
    faces=(150, 350, CLOSE_UP_PX),
    clips=(0.5, 1.0, 1.5),
    size_frames=(24, 8),
    in_full=True,
)
QUICK = Effort(
    *(60, 2, 2, 10, 8, 3, 24, 15),
    frame_counts=(24, 48, 96),
    look_counts=(1, 2, 4),
    look_frames=48,
    faces=(200, CLOSE_UP_PX),
    clips=(0.5, 1.0),
    size_frames=(10, 4),
    in_full=False,
)


@dataclass
class Suite:
    """Material, effort and what was measured so far."""

    material: Material
    effort: Effort
    folder: Path
    results: dict[str, Any] = field(default_factory=dict)

    @cached_property
    def clip(self) -> Path:
        """The clip of the whole runs: as it is with its sound, unless it is too long."""
        count = probe(self.material.clip).frame_count
        if count <= self.effort.clip_frames:
            return self.material.clip
        return make_clip(self.material.clip, self.folder / "clip.mp4", self.effort.clip_frames)

    @cached_property
    def references(self) -> tuple[Path, ...]:
        """Assets of the portraits."""
        assets = []
        for portrait in self.material.portraits:
            assets.append(self.folder / f"{portrait.stem}.pvg")
            pvg.vectorize(portrait, reference=True, asset=assets[-1]).close()
        return tuple(assets)

    def _job(self, clip: Path) -> Job:
        asset = self.folder / f"asset-of-{clip.stem}.pvg"
        if not asset.exists():
            pvg.vectorize(clip, asset=asset).close()
        return Job(clip, asset, self.references)

    @cached_property
    def job(self) -> Job:
        """The clip, vectorised."""
        return self._job(self.clip)

    @cached_property
    def close_up(self) -> Job:
        """The clip drawn nearer, until its face is `CLOSE_UP_PX` wide."""
        window = face_windows(self.job, [CLOSE_UP_PX])[CLOSE_UP_PX]
        count = self.effort.close_up_frames
        return self._job(make_clip(self.material.clip, self.folder / "close-up.mp4", count, window))

    @cached_property
    def long_job(self) -> Job:
        """600 frames of the clip there and back, vectorised alone for the peak memory."""
        clip = make_clip(self.material.clip, self.folder / "long.mp4", FRAMES)
        asset = self.folder / "long.pvg"
        alone = run_alone(vectorize_clip, clip, asset)
        memory = self.results.setdefault("memory", {})
        memory[f"vectorising {FRAMES} frames"] = alone.peak_mb
        self.results["long vectorise"] = alone.result
        return Job(clip, asset, self.references)

    def membrane(self) -> None:
        """One membrane of a large face, and its error on several, each in the colours of the next portrait."""
        assets = self.references
        paths = zip(self.material.portraits, assets, (*assets[1:], assets[0]), strict=True)
        faces = [tuple(map(str, face)) for face in paths][: self.effort.portraits]
        self.results["membrane"] = run_alone(membrane_times, faces, self.effort.membranes, one_thread=True).result

    def _stages(self, job: Job) -> Any:
        arguments = (job.clip, job.asset, job.references[0], self.effort.stage_frames)
        return run_alone(stage_times, *arguments, one_thread=True).result

    def stages(self) -> None:
        """Stage times, on the clip and on a face as large as the paper's."""
        self.results["stages"] = self._stages(self.job)
        self.results["close-up stages"] = self._stages(self.close_up)

    def runs(self) -> None:
        """Whole runs in turns."""
        self.results["runs"] = whole_runs(self.job, self.effort.rounds)
        self.results["close-up runs"] = whole_runs(self.close_up, 1, full=False)
        self.results["color transfer"] = color_transfer(self.long_job if self.effort.in_full else self.job, FRAMES)
        info = probe(self.clip)
        self.results["asset"] = {
            "bytes": self.job.asset.stat().st_size,
            "source_bytes": self.clip.stat().st_size,
            "frames": sum(1 for _ in read_frames(self.clip)),
            "pixels": info.width * info.height,
        }

    def single(self) -> None:
        """Portraits and single frames."""
        self.results["references"] = references(self.material.portraits[: self.effort.portraits], self.effort.rounds)
        self.results["single frames"] = single_frames(self.job, self.effort.random_frames)

    def rivals(self) -> None:
        """The peers on the clip and on the close-up."""
        frames = self.effort.rival_frames
        for name, job, count in (("rivals", self.job, frames), ("close-up rivals", self.close_up, frames // 3)):
            arguments = (job.clip, job.asset, self.material.portraits[0], job.references[0], count)
            self.results[name] = run_alone(rival_times, *arguments, one_thread=True).result

    def memory(self) -> None:
        """Peak memory of processes that do one job each; in full also 10 looks of 600 frames, timed."""
        memory = self.results.setdefault("memory", {})
        if not self.effort.in_full:
            alone = run_alone(vectorize_clip, self.clip, self.folder / "alone.pvg")
            memory[f"vectorising {alone.result['frames']} frames"] = alone.peak_mb
            memory["rendering one look"] = self._transfer_alone(self.job, 1).peak_mb
            return
        job = self.long_job
        memory[f"rendering one look, {FRAMES} frames"] = self._transfer_alone(job, 1).peak_mb
        ten = self._transfer_alone(job, LOOKS)
        memory[f"rendering {LOOKS} looks at once"] = ten.peak_mb
        self.results["ten looks"] = {
            "vectorise_s": self.results["long vectorise"]["wall_s"],
            "transfer_s": ten.result["wall_s"],
            "stage_s": ten.result["stage_s"],
        }

    def _transfer_alone(self, job: Job, looks: int) -> Any:
        target = self.folder / "looks"
        target.mkdir(exist_ok=True)
        return run_alone(transfer_clip, job.clip, job.asset, [str(path) for path in job.references], looks, target)

    def growth(self) -> None:
        """Growth with frames, looks and sizes."""
        effort, folder = self.effort, self.folder
        frames = over_frames(self.material.clip, folder, self.references, effort.frame_counts)
        looks = over_looks(folder, self.references, effort.look_frames, effort.look_counts)
        self.results["growth"] = {"frames": frames, "looks": looks}

    def sizes(self) -> None:
        """Stage times over face and clip size."""
        length, frames = self.effort.size_frames
        windows = face_windows(self.job, self.effort.faces), clip_windows(self.job, self.effort.clips)
        self.results["sizes"] = over_sizes(self.job, self.folder, *windows, length=length, frames=frames)

    def http(self) -> None:
        """The service asked for a transfer; in full only."""
        if self.effort.in_full:
            self.results["http"] = over_http(self.clip, self.material.portraits[:1], 2)

    def run(self, only: tuple[str, ...]) -> None:
        """Run the sections, all of them when `only` is empty."""
        for name in SECTIONS:
            if only and name not in only:
                continue
            started = time.perf_counter()
            getattr(self, name)()
            print(f"{name}: {time.perf_counter() - started:.0f} s", file=sys.stderr, flush=True)
        if {"stages", "rivals"} <= set(self.results):
            self.results["cost analysis"] = {"times": self._costs()}

    def _costs(self) -> dict[str, dict[str, float]]:
        out = {}
        for prefix in ("", "close-up "):
            stages, rivals = self.results[f"{prefix}stages"], self.results[f"{prefix}rivals"]
            name = f"face {stages['face_px']:.0f} px in {stages['size'][0]}x{stages['size'][1]}"
            out[name] = cost_times(stages["ms"], rivals["ms"][PLAIN_OMT]["median"])
        return out
