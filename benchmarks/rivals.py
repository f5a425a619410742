"""What a user could take instead, on the same frames, masks and reference, held to one core."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import pvg
from benchmarks.quality.faces import Image, Reference, View, read_reference, sample_pixels, view_of
from benchmarks.quality.peers import LINEAR, RASTER, Replayed, fit_linear, missing, open_peers
from benchmarks.timing import Measured, cpu_ms, in_turns
from pvg.looks import sliced_transport
from pvg.rendering import Renderer
from pvg.video import Frame, read_frames

OURS_NAME = "ours"
PLAIN_OMT = "raster OMT, every pixel"
EQUAL_ONCE = "raster OMT, equal colours once"
_OMT_SAMPLE = 4000
_SLOW_MS = 1000.0
_SLOW_FRAMES = 2


@dataclass(frozen=True, eq=False)
class RasterTransport:
    """Eq. (7, 8) on every pixel under the matte, as the paper's rival does it."""

    reference: Reference

    def draw(self, frame: Frame, view: View) -> Image:
        """The frame in the reference's colours."""
        rgb = frame.rgb()
        touched = view.alpha > 0
        part = view.crop(rgb).astype(np.float32)
        wanted = sample_pixels(self.reference.face, _OMT_SAMPLE)
        moved = sliced_transport(part[touched], wanted, rng=np.random.default_rng(0))
        part[touched] += view.alpha[touched][:, None] * (moved.astype(np.float32) - part[touched])
        out = rgb.copy()
        out[view.window] = np.clip(np.rint(part), 0, 255).astype(np.uint8)
        return out


def _works(video: pvg.VectorVideo, face: int, reference: Reference) -> dict[str, Callable[[Frame, View], Any]]:
    """Method -> (frame, view) -> picture."""
    look = pvg.transfer(video, reference.video, faces=[face])
    renderer = Renderer(video, [look])
    works: dict[str, Callable[[Frame, View], Any]] = {OURS_NAME: lambda frame, view: renderer.patches(frame)}
    for method in open_peers([reference]):
        works[EQUAL_ONCE if method.name == RASTER else method.name] = method.draw
    works[PLAIN_OMT] = RasterTransport(reference).draw
    return works


def rival_times(clip: str, asset: str, portrait: str, reference_asset: str, frames: int) -> dict[str, Any]:
    """Milliseconds a frame of every method, what each does once a clip and reference, and facts.

    Finding the face is a gift to the peers that need it; reading it back to the clip's planes is not counted for them.
    """
    with pvg.open_asset(asset, clip) as video:
        reference = read_reference(Path(portrait), Path(reference_asset))
        face = max(video.faces, key=lambda summary: summary.width_px)
        first = face.first_frame
        size = (video.media.width, video.media.height)
        works = _works(video, face.index, reference)
        taken: dict[str, list[float]] = {name: [] for name in works}
        pixels = 0
        for turn, frame in enumerate(read_frames(Path(clip), start=first, stop=first + frames + 1)):
            data = video.face_at(face.index, frame.index)
            if data is None:
                continue
            view = view_of(data, size)
            pixels = max(pixels, int((view.alpha > 0).sum()))
            for name, work in works.items():
                if len(taken[name]) >= _SLOW_FRAMES and taken[name][-1] > _SLOW_MS:
                    continue
                fresh = replace(frame)  # its own colours, not yet converted for the method before
                milliseconds = cpu_ms(partial(work, fresh, view))
                if turn > 0:  # the first meets everything cold
                    taken[name].append(milliseconds)
        return {
            "ms": {name: Measured(tuple(values)).to_json() for name, values in taken.items()},
            "once_ms": _once(video, face.index, reference, clip),
            "missing": missing(),
            "size": list(size),
            "face_px": face.width_px,
            "matte_pixels": pixels,
        }


def _once(video: pvg.VectorVideo, face: int, reference: Reference, clip: str) -> dict[str, Any]:
    """Milliseconds of what ours and the masked linear transport do once a clip and reference."""
    (frame,) = read_frames(Path(clip), start=video.faces[face].first_frame, stop=video.faces[face].first_frame + 1)
    data = video.face_at(face, frame.index)
    assert data is not None
    view = view_of(data, (frame.width, frame.height))

    def masked_linear() -> None:
        Replayed(LINEAR, [reference], fit_linear).draw(frame, view)

    taken = in_turns(
        {OURS_NAME: lambda: pvg.transfer(video, reference.video, faces=[face]), LINEAR: masked_linear},
        5,
    )
    return {name: one.cpu.scaled(1000.0).to_json() for name, one in taken.items()}
