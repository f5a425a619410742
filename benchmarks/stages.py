"""CPU time of each stage on its own, held to one core, on frames of one clip."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import pvg
from benchmarks.clips import encode
from benchmarks.timing import Measured, cpu_ms, seconds
from pvg._arrays import Floats
from pvg.asset import FaceInFrame
from pvg.curves import labels_by_length, match, table_labels
from pvg.landmarks import detect_faces, fit_landmarks, region_of_points
from pvg.looks import sliced_transport
from pvg.rendering import PlacedFace, Renderer
from pvg.rendering.correction import Correction, CurveCorrection, at_curves, extend
from pvg.rendering.guards import guarded_alpha
from pvg.rendering.map_tables import MapTables
from pvg.rendering.placed_face import place_face
from pvg.rendering.planes import apply_correction, fade_in_dark
from pvg.skin import SkinTracker, fit_skin_model
from pvg.vectorization.key_colors import fit_key_frame
from pvg.video import Frame, picture_of, probe, read_frames

KEY_FRAME_STAGES = ("skin model", "fit")
LOOK_STAGES = ("transport", "look")
_KEY_REPEATS = 3
_SPACING_PX = 2.0
_CODED_FRAMES = 48  # decoding and encoding need a run-up


class _Stages:
    """The frames of one face and the times taken on them, in milliseconds."""

    def __init__(self, video: pvg.VectorVideo, reference: pvg.VectorVideo) -> None:
        self.video, self.reference = video, reference
        self.face = max(video.faces, key=lambda face: face.width_px).index
        self.key = video.records[self.face].key_frames[0]
        self.look = pvg.transfer(video, reference, faces=[self.face])
        self.renderer = Renderer(video, [self.look])
        self.taken: dict[str, list[float]] = {}
        self.untouched = True
        self._tracker: SkinTracker | None = None
        self._points: Any = None

    def data(self, index: int) -> FaceInFrame | None:
        return self.video.face_at(self.face, index)

    def time(self, name: str, milliseconds: float) -> None:
        self.taken.setdefault(name, []).append(milliseconds)

    def analyse(self, frame: Frame, data: FaceInFrame) -> None:
        """Stages of the vectoriser that every frame goes through."""
        self.time("to RGB", cpu_ms(lambda: replace(frame).rgb()))  # what peers and single frames need, not ours
        picture = picture_of(frame)
        self.time("detect", cpu_ms(lambda: detect_faces(picture)))
        region = detect_faces(picture)[0] if self._points is None else region_of_points(self._points)
        meshes: list[Any] = []
        self.time("landmarks", cpu_ms(lambda: meshes.append(fit_landmarks(picture, region))))
        self._points = meshes[0].points
        if self._tracker is None:
            self._tracker = SkinTracker(fit_skin_model(picture, data.landmarks))
        tracker = self._tracker
        self.time("mask", cpu_ms(lambda: tracker.step(picture, data.landmarks)))

    def key_frame(self, frame: Frame, data: FaceInFrame, placed: PlacedFace) -> None:
        """Stages done once: the key frame's skin model and boundary colours, and a look."""
        picture, rgb, width = picture_of(frame), frame.rgb(), data.landmarks.axes.width
        model = fit_skin_model(picture, data.landmarks)
        matte = SkinTracker(model).step(picture, data.landmarks)
        wanted = self.reference.records[0].key_frames[0].colors
        rng = np.random.default_rng(0)
        for _ in range(_KEY_REPEATS):
            self.time("skin model", cpu_ms(lambda: fit_skin_model(picture, data.landmarks)))
            self.time("fit", cpu_ms(lambda: fit_key_frame(rgb, matte, placed.positions, width, 0)))
            self.time("transport", cpu_ms(lambda: sliced_transport(self.key.colors, wanted, rng=rng)))
            self.time("look", cpu_ms(lambda: pvg.transfer(self.video, self.reference, faces=[self.face])))

    def draw(self, frame: Frame, data: FaceInFrame) -> PlacedFace | None:
        """Stages of the renderer."""
        size = (frame.width, frame.height)
        found: list[PlacedFace | None] = []
        curves = cpu_ms(lambda: found.append(place_face(data, table_labels(), *size)))
        placed = found[0]
        if placed is None:
            return None
        g, wanted = self._wanted(frame)
        corrections: list[Correction] = []
        self.time("curves", curves)
        level = 2.0 ** (frame.format.depth - 8)
        self.time("membrane", cpu_ms(lambda: corrections.extend(extend(placed, g, [wanted], level=level))))
        self.time("apply", cpu_ms(lambda: _apply(frame, placed, corrections[0], self.look)))
        self.time("draw in all", cpu_ms(lambda: self.renderer.patches(frame)))
        labels = labels_by_length(data.landmarks, data.boundary, spacing_px=_SPACING_PX)
        self.time("match", cpu_ms(lambda: match(wanted.shift, table_labels(), labels)))
        (matte,) = self.renderer.mattes(frame, 0, [[self.face]])
        self.untouched &= _outside_untouched(frame, self.renderer.draw(frame)[0], matte)
        return placed

    def _wanted(self, frame: Frame) -> tuple[Floats, CurveCorrection]:
        """The boundary colours in the planes of a frame, and what the look asks for there."""
        to_planes = frame.format.opponent.matrix.astype(np.float32).T
        g = self.key.colors @ to_planes
        # a look of the defaults is drawn by its map
        tables = MapTables.of(self.look.maps[self.face], frame.format)
        return g, at_curves(g, self.look.colors[self.face][0] @ to_planes, tables)


def _apply(frame: Frame, placed: PlacedFace, correction: Correction, look: pvg.Look) -> None:
    alpha, guards = guarded_alpha(placed, look.protect)
    corner = placed.x, placed.y
    fade = fade_in_dark(frame, corner, alpha, [correction])
    apply_correction(frame, corner, alpha, correction, guards=[(guard, 0.8) for guard in guards], fade=fade)


def _outside_untouched(before: Frame, after: Frame, matte: Floats) -> bool:
    """Whether all samples whose pixels a matte (H, W) does not reach kept their bits."""
    for p, (old, new) in enumerate(zip(before.planes, after.planes, strict=True)):
        dx, dy = before.format.chroma_log2 if p else (0, 0)
        reached = np.zeros(old.shape, np.bool_)
        ys, xs = np.nonzero(matte)
        reached[ys >> dy, xs >> dx] = True
        if ((old != new) & ~reached).any():
            return False
    return True


def stage_times(clip: str, asset: str, reference: str, frames: int) -> dict[str, Any]:
    """Milliseconds of each stage over the face's first `frames` frames, and facts about them."""
    with pvg.open_asset(asset, clip) as video, pvg.open_asset(reference) as colors:
        stages = _Stages(video, colors)
        summary = video.faces[stages.face]
        first = summary.first_frame
        kept: list[Frame] = []
        decoding = _decode(Path(clip), first, frames, kept)
        widths: list[float] = []
        for turn, frame in enumerate(_warm(kept)):
            data = stages.data(frame.index)
            if data is None or data.score <= 0:
                continue
            if turn == 1:  # the first frame met everything cold
                stages.taken.clear()
            stages.analyse(frame, data)
            placed = stages.draw(frame, data)
            if placed is not None and "fit" not in stages.taken and turn > 0:
                stages.key_frame(frame, data, placed)
            widths.append(data.landmarks.axes.width)
        taken = {name: Measured(tuple(values)) for name, values in stages.taken.items()}
        taken["decode"] = Measured((decoding,))
        taken["encode"] = Measured((_encode(Path(clip), kept),))
        shown = stages.data(first)
        return {
            "ms": {name: measured.to_json() for name, measured in taken.items()},
            "frames": len(kept),
            "size": [video.media.width, video.media.height],
            "face_px": float(np.median(widths)),
            "box_px": [] if shown is None else _sides(shown.matte.raster.box),
            "outside_untouched": stages.untouched,
        }


def _sides(box: Floats) -> list[int]:
    return [round(float(v)) for v in box[2:] - box[:2]]


def _warm(frames: list[Frame]) -> Iterator[Frame]:
    yield frames[0]
    yield from frames


def _decode(clip: Path, first: int, count: int, kept: list[Frame]) -> float:
    """CPU milliseconds a frame of reading the clip's first frames; `count` of the face are kept."""
    read: list[int] = []

    def decode() -> None:
        for frame in read_frames(clip, stop=max(first + count, _CODED_FRAMES)):
            read.append(frame.index)
            if first <= frame.index < first + count:
                kept.append(frame)

    taken = seconds(decode)[1]
    return taken * 1000.0 / len(read)


def _encode(clip: Path, frames: list[Frame]) -> float:
    """CPU milliseconds a frame of writing frames, there and back, with the settings a transfer uses."""
    info = probe(clip)
    with tempfile.TemporaryDirectory() as folder:
        taken = seconds(lambda: encode(Path(folder) / "encoded.mp4", info, frames, _CODED_FRAMES))[1]
    return taken * 1000.0 / _CODED_FRAMES
