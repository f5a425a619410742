"""Each stage of the method on its own, on frames of one clip."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import pvg
from pvg.boundary import fit_boundary_colors
from pvg.curves import face_frame, table_labels
from pvg.landmarks import detect_faces, fit_landmarks
from pvg.poisson import build_membrane
from pvg.region import open_region
from pvg.rendering import Renderer, source_frame
from pvg.skin import SkinTracker, fit_skin_model
from pvg.transport import sliced_transport

_FRAMES = 24
_REPEATS = 5


def _median_ms(works: list[Callable[[], Any]]) -> float:
    times = []
    for work in works:
        start = time.perf_counter()
        work()
        times.append((time.perf_counter() - start) * 1000)
    return statistics.median(times)


def stage_times(clip: Path, reference: Path) -> dict[str, float]:
    """Median milliseconds of each stage, a frame or a call."""
    with pvg.vectorize(clip) as video, pvg.vectorize(reference, reference=True) as colors:
        first = video.faces[0].first_frame
        count = min(_FRAMES, video.faces[0].last_frame - first + 1)
        frames = [source_frame(video, first + i) for i in range(count)]
        data = [video.face_frame(0, frame.index) for frame in frames]
        faces = [d for d in data if d is not None]
        pictures = [frame.rgb() for frame in frames]
        model = fit_skin_model(pictures[0], faces[0].points, faces[0].skin_points, method="landmarks")
        tracker = SkinTracker(model)
        key, target = video.records[0].key_frames[0], colors.records[0].key_frames[0]
        size = (frames[0].width, frames[0].height)
        regions = [open_region(face, table_labels(), *size) for face in faces]
        drawable = [region for region in regions if region is not None]
        look = pvg.transfer(video, colors)
        renderer = Renderer(video, [look])
        change = look.colors[0][0] - key.colors
        width = face_frame(faces[0].points).width
        rng = np.random.default_rng(0)
        domain = np.zeros(pictures[0].shape[:2], np.bool_)
        region = drawable[0]
        domain[region.y : region.y + region.alpha.shape[0], region.x : region.x + region.alpha.shape[1]] = (
            region.alpha > 0.5
        )
        return {
            "planes to RGB": _median_ms([lambda f=f: f.format.fast_rgb(f.planes) for f in frames]),
            "detect": _median_ms([lambda p=p: detect_faces(p) for p in pictures]),
            "landmarks": _median_ms([lambda p=p: fit_landmarks(p, detect_faces(p)[0]) for p in pictures])
            - _median_ms([lambda p=p: detect_faces(p) for p in pictures]),
            "skin model (key frame)": _median_ms(
                [
                    lambda: fit_skin_model(pictures[0], faces[0].points, faces[0].skin_points, method="landmarks")
                    for _ in range(_REPEATS)
                ]
            ),
            "skin matte": _median_ms(
                [
                    lambda p=p, d=d: tracker.step(p, d.points, d.skin_points)
                    for p, d in zip(pictures, faces, strict=True)
                ]
            ),
            "fit g (key frame)": _median_ms(
                [
                    lambda: fit_boundary_colors(pictures[0], domain, region.positions, h_min=width / 100, rng=rng)
                    for _ in range(_REPEATS)
                ]
            ),
            "transport (a look)": _median_ms(
                [lambda: sliced_transport(key.colors, target.colors, rng=rng) for _ in range(_REPEATS)]
            ),
            "place curves, cut lattice": _median_ms([lambda d=d: open_region(d, table_labels(), *size) for d in faces]),
            "membrane": _median_ms([lambda r=r: build_membrane(r.raster).solve(change) for r in drawable]),
            "draw a look (all)": _median_ms([lambda f=f: renderer.draw(f) for f in frames]),
        }
