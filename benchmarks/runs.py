"""Whole runs against the clip's own decoding and encoding, in turns; single frames; references; memory."""

from __future__ import annotations

import importlib
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import av
import numpy as np

import pvg
from benchmarks.clips import encode
from benchmarks.timing import Measured, in_turns, seconds
from pvg.rendering import Renderer
from pvg.video import Frame, MediaInfo, VideoWriter, probe, read_frames
from pvg.video.encoders import encoder_options
from pvg.warmup import warm_up

FURTHER = 3  # looks of the request that tells what a further look costs
RATIOS = (
    "further look / encode",
    "one look / transcode",
    "one look / bare transcode",
    "vectorise / decode",
)
_HELD_FRAMES = 48  # of the clip, encoded there and back: 1080p in memory
_COLOR_REPEATS = 15
_WORKER_LIBRARIES = ("celery", "sqlalchemy", "structlog", "obstore", "httpx", "pydantic_settings")


@dataclass(frozen=True)
class Job:
    """A clip and its references, all vectorised."""

    clip: Path
    asset: Path
    references: tuple[Path, ...]  # assets

    def looks(self, count: int) -> list[pvg.Look]:
        """`count` looks of the clip; beyond the number of references with other rotations."""
        with pvg.open_asset(self.asset, self.clip) as video:
            return _looks(video, self.references, count)


def _looks(video: pvg.VectorVideo, references: Sequence[Path], count: int) -> list[pvg.Look]:
    looks = []
    for number in range(count):
        with pvg.open_asset(references[number % len(references)]) as colors:
            looks.append(pvg.transfer(video, colors, seed=number // len(references)))
    return looks


def decode(clip: Path) -> None:
    """Read every frame's planes."""
    for _ in read_frames(clip):
        pass


def transcode(clip: Path, target: Path) -> None:
    """Decode and encode with the settings a transfer uses, sound copied."""
    info = probe(clip)
    with VideoWriter(target, info, info.format, audio_from=clip) as writer:
        for frame in read_frames(clip):
            writer.write(frame)


def bare_transcode(clip: Path, target: Path) -> None:
    """The same by the codec library alone, no planes copied: H.264 without sound."""
    with av.open(str(clip)) as source, av.open(str(target), "w") as output:
        pictures = source.streams.video[0]
        pictures.thread_type = "AUTO"
        rate = pictures.average_rate or Fraction(25)
        stream: Any = output.add_stream("libx264", rate=rate, options=encoder_options("h264", None, None))
        stream.width, stream.height, stream.pix_fmt = pictures.width, pictures.height, pictures.pix_fmt
        stream.codec_context.thread_type = "AUTO"
        stream.codec_context.time_base = pictures.time_base
        for picture in source.decode(pictures):
            picture.pict_type = av.video.frame.PictureType.NONE
            output.mux(stream.encode(picture))
        output.mux(stream.encode(None))


def transfer(job: Job, looks: int, folder: Path) -> None:
    """What a transfer request does: open the asset, make the looks, render them all in one pass."""
    with pvg.open_asset(job.asset, job.clip) as video:
        paths = [folder / f"look-{number}.mp4" for number in range(looks)]
        pvg.render(video, _looks(video, job.references, looks), paths)


def _be_a_worker() -> None:
    """Load what a worker holds besides, so that its memory counts, and compile."""
    for name in _WORKER_LIBRARIES:
        importlib.import_module(name)
    warm_up()


def vectorize_clip(clip: str, asset: str) -> dict[str, Any]:
    """Vectorise a clip; its frames and the asset's size in bytes. Compiled kernels and networks are loaded before."""
    _be_a_worker()
    taken = seconds(lambda: pvg.vectorize(clip, asset=asset).close())
    with pvg.open_asset(asset) as video:
        return {"wall_s": taken[0], "cpu_s": taken[1], "frames": video.frame_count, "bytes": Path(asset).stat().st_size}


def transfer_clip(clip: str, asset: str, references: list[str], looks: int, folder: str) -> dict[str, Any]:
    """Give a clip its looks: seconds of the transfer stage alone and of the whole."""
    _be_a_worker()
    job = Job(Path(clip), Path(asset), tuple(map(Path, references)))
    whole = seconds(lambda: transfer(job, looks, Path(folder)))
    stage = seconds(lambda: job.looks(looks))
    return {"wall_s": whole[0], "cpu_s": whole[1], "stage_s": stage[0]}


def whole_runs(job: Job, rounds: int, *, full: bool = True) -> dict[str, Any]:
    """Wall seconds of whole runs in turns; full: the plain and the bare transcode and a vectorisation too."""
    info = probe(job.clip)
    count = sum(1 for _ in read_frames(job.clip))
    further = further_looks(job)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        works: dict[str, Any] = {
            # the very pictures that the further looks encode: brighter ones cost more than the clip's own
            "encode": lambda: _encode_all(folder / "encoded.mp4", info, further, count),
            "one look": lambda: transfer(job, 1, folder),
            f"{FURTHER} looks": lambda: transfer(job, FURTHER, folder),
        }
        if full:
            works |= {
                "decode": lambda: decode(job.clip),
                "transcode": lambda: transcode(job.clip, folder / "transcoded.mp4"),
                "bare transcode": lambda: bare_transcode(job.clip, folder / "bare.mp4"),
                "vectorise": lambda: pvg.vectorize(job.clip, asset=folder / "again.pvg").close(),
            }
        transfer(job, 1, folder)  # compiles and warms up
        taken = in_turns(works, rounds)
        sizes = {path.stem: path.stat().st_size for path in sorted(folder.glob("*.mp4"))}
    wall = {name: one.wall for name, one in taken.items()}
    cpu = {name: one.cpu for name, one in taken.items()}
    ratios: dict[str, Any] = {}
    for clock in (wall, cpu):
        clock["encode"] = clock["encode"].scaled(1 / len(further))
        clock["further look"] = clock[f"{FURTHER} looks"].less(clock["one look"]).scaled(1 / (FURTHER - 1))
    for name in RATIOS if full else RATIOS[:1]:
        above, below = name.split(" / ")
        ratios[name] = {**wall[above].over(wall[below]).to_json(), "cpu": cpu[above].over(cpu[below]).to_json()}
    return {
        "frames": count,
        "size": [info.width, info.height],
        "s": {name: {**wall[name].to_json(), "cpu": cpu[name].to_json()} for name in wall},
        "ratios": ratios,
        "bytes": sizes,
    }


def _encode_all(target: Path, info: MediaInfo, looks: Sequence[Sequence[Frame]], count: int) -> None:
    for held in looks:
        encode(target, info, held, count)


def further_looks(job: Job) -> list[list[Frame]]:
    """The first frames of the clip in each look of a request but the first."""
    with pvg.open_asset(job.asset, job.clip) as video:
        renderer = Renderer(video, _looks(video, job.references, FURTHER)[1:])
        drawn = [renderer.draw(frame) for frame in read_frames(job.clip, stop=_HELD_FRAMES)]
    return [list(frames) for frames in zip(*drawn, strict=True)]


def color_transfer(job: Job, clip_frames: int) -> dict[str, Any]:
    """Wall milliseconds a frame of one look's transport and the curve colours of all frames.

    The transport is done once, so it is shared by `clip_frames` frames; the colours of a frame are measured over the
    clip's own frames.
    """
    with pvg.open_asset(job.asset, job.clip) as video, pvg.open_asset(job.references[0]) as reference:
        look = pvg.transfer(video, reference)
        works: dict[str, Callable[[], Any]] = {
            "transport": lambda: pvg.transfer(video, reference),
            "colours": lambda: _all_curve_colors(video, look),
        }
        for work in works.values():
            work()
        taken = in_turns(works, _COLOR_REPEATS)
        share = clip_frames / video.frame_count
        wall = [
            (once + all_frames * share) * 1000.0 / clip_frames
            for once, all_frames in zip(taken["transport"].wall.values, taken["colours"].wall.values, strict=True)
        ]
        parts = {name: one.wall.scaled(1000.0).to_json() for name, one in taken.items()}
        measured = Measured(tuple(wall)).to_json()
        return {"ms_per_frame": measured, "frames": clip_frames, "measured": video.frame_count, "parts_ms": parts}


def _all_curve_colors(video: pvg.VectorVideo, look: pvg.Look) -> None:
    for face, colors in look.colors.items():
        record = video.records[face]
        # eq. (5) with a clip-wide table: a frame's colours are those of its key frame at the same labels
        change = [new - key.colors for new, key in zip(colors, record.key_frames, strict=True)]
        numbers = {key.frame: number for number, key in enumerate(record.key_frames)}
        for frame in range(record.summary.first_frame, record.summary.last_frame + 1):
            change[numbers[record.key_frame_of(frame).frame]].copy()


def single_frames(job: Job, count: int) -> dict[str, Any]:
    """Wall milliseconds of `render_frame` at random frames of an open asset."""
    with pvg.open_asset(job.asset, job.clip) as video:
        (look,) = _looks(video, job.references, 1)
        pvg.render_frame(video, look, 0)
        wanted = np.random.default_rng(0).integers(0, video.frame_count, count)
        taken = [seconds(partial(pvg.render_frame, video, look, int(index)))[0] * 1000.0 for index in wanted]
    measured = Measured(tuple(taken))
    return {**measured.to_json(), "p90": float(np.percentile(taken, 90)), "file_cached": True}


def references(portraits: Sequence[Path], repeats: int) -> dict[str, Any]:
    """Wall seconds of vectorising each portrait as a reference and as an image to be drawn, weights loaded."""
    out: dict[str, Any] = {}
    for kind, reference in (("reference", True), ("image", False)):
        medians = {}
        for portrait in portraits:
            works = {"one": lambda p=portrait, r=reference: pvg.vectorize(p, reference=r).close()}
            works["one"]()
            medians[portrait.stem] = in_turns(works, repeats)["one"].wall.median
        out[kind] = {**Measured(tuple(medians.values())).to_json(), "each": medians}
    return out
