"""Single pictures of a clip: previews of a look, a poster, the faces in it. What they share is kept."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from pvg._arrays import Bytes
from pvg._threads import one_blas_thread
from pvg.asset import FaceInFrame, VectorVideo, check_vectorized
from pvg.looks import Look
from pvg.rendering.canvas import check_index, count_of_file, frame_of_file, frames_of_file
from pvg.rendering.layers import layer
from pvg.rendering.pictures import Box, around, on_white, thumbnail
from pvg.rendering.renderer import Renderer
from pvg.video import Frame, frame_at, key_pictures

_KEPT_PIXELS: Final = 40_000_000  # of decoded frames: some at 1080p, one at the largest size


@dataclass(frozen=True)
class SeenFace:
    """Where a face is seen well.

    index: its number;  frame: where it is seen;  box: of its outline there;  picture: (S, S, 3) uint8 RGB, a square
    around it.
    """

    index: int
    frame: int
    box: Box
    picture: Bytes


class Stills:
    """A clip, a picture or a reference of which single frames are asked for, by their number in display order.

    Decoding a frame begins at the key picture before it, which may be hundreds of frames away: `nearest` says which
    frame is quick to have. The frames that were asked for last are kept.
    """

    def __init__(self, video: VectorVideo) -> None:
        check_vectorized(video)
        self.video = video
        self._frames: OrderedDict[int, Frame] = OrderedDict()
        # of a reference only the beginning was read
        self._frame_count = count_of_file(video)
        keys = key_pictures(video.require_source(), video.limits, frame_count=self._frame_count)
        # None where packets do not tell: then decoding begins at the first frame
        self._keys = None if keys is None else tuple(key for key in keys if key < video.frame_count)

    def frame(self, index: int) -> Frame:
        """Frame `index`. Raises `ValueError` when there is none, `MediaError` when it cannot be read."""
        if index not in self._frames:
            self._keep(frame_of_file(self.video, index))
        self._frames.move_to_end(index)
        return self._frames[index]

    def nearest(self, index: int) -> int:
        """The frame nearest to `index` that is decoded from itself alone; `index` where none is known.

        Raises `ValueError` when there is no frame `index`.
        """
        check_index(self.video, index)
        if index in self._frames or not self._keys:
            return index
        return min(self._keys, key=lambda key: (abs(key - index), key))

    def at_time(self, time_s: float) -> int:
        """The frame that is shown so many seconds after the first one."""
        known = frame_at(self.video.require_source(), time_s, self.video.limits, frame_count=self._frame_count)
        if known is None:
            known = int(time_s * (self.video.media.frame_rate or 0.0) + 1e-3)
        return min(max(known, 0), self.video.frame_count - 1)

    def usual_frame(self, faces: Collection[int] | None = None) -> int:
        """A frame in which the largest of these faces, or of all, is seen well, if possible one that is quick to have.

        Raises `ValueError` on an unknown face.
        """
        known = {face.index: face for face in self.video.faces}
        if unknown := set(faces or ()) - known.keys():
            raise ValueError(f"no face {min(unknown)}; the clip has {len(known)}")
        chosen = [known[index] for index in sorted(faces or known)]
        best = max(chosen, key=lambda face: face.width_px)
        at = self.video.records[best.index].key_frames[0].frame
        quick = [key for key in self._keys or () if best.first_frame <= key <= best.last_frame]
        nearest_first = sorted(quick, key=lambda key: (abs(key - at), key))
        return next((key for key in nearest_first if self._face(best.index, key) is not None), at)

    def drawn(self, look: Look | None, index: int) -> Bytes:
        """Frame `index` with a look, or as it is: (H, W, 3) uint8 RGB as an SDR display shows it."""
        frame = self.frame(index)
        with one_blas_thread():
            return on_white(frame if look is None else Renderer(self.video, [look]).draw(frame)[0])

    def layer(self, index: int, name: str) -> Bytes:
        """Layer `name` of frame `index`, see `pvg.rendering.layer`."""
        return layer(self.video, index, name, frame=self.frame(index))

    def face_box(self, face: int, index: int) -> Box:
        """The box of a face's outline in frame `index`, within the picture.

        Raises `ValueError` when there is no such face, or when it is not seen there.
        """
        if not 0 <= face < len(self.video.faces):
            raise ValueError(f"no face {face}; there are {len(self.video.faces)}")
        seen = self._face(face, index)
        if seen is None:
            known = self.video.faces[face]
            raise ValueError(
                f"face {face} is not in frame {index}; it is in frames {known.first_frame} to {known.last_frame}"
            )
        return self._box(seen)

    def seen_faces(self, faces: Sequence[int], size_px: int) -> list[SeenFace]:
        """These faces, each where it is seen well, in squares of `size_px`, by their numbers.

        One that is seen nowhere is left out. Key pictures are decoded by themselves, the others in one reading.
        """
        at: dict[int, list[int]] = {}
        for face in faces:
            at.setdefault(self.usual_frame([face]), []).append(face)
        found = [
            SeenFace(face, frame.index, box := self._box(seen), thumbnail(on_white(frame), around(box), size_px))
            for frame in self._several(sorted(at))
            for face in at[frame.index]
            if (seen := self._face(face, frame.index)) is not None
        ]
        return sorted(found, key=lambda one: one.index)

    def _several(self, indices: Sequence[int]) -> Iterator[Frame]:
        """These frames (ascending): key pictures and those that are kept first, then the others in one reading."""
        keys = set(self._keys or ())
        others = [index for index in indices if index not in keys and index not in self._frames]
        for index in indices:
            if index not in others:
                yield self.frame(index)
        if others:
            for frame in frames_of_file(self.video, others[0], others[-1] + 1):
                if frame.index in others:
                    yield frame

    def _keep(self, frame: Frame) -> None:
        self._frames[frame.index] = frame
        while len(self._frames) > max(1, _KEPT_PIXELS // (frame.width * frame.height)):
            self._frames.popitem(last=False)

    def _face(self, face: int, index: int) -> FaceInFrame | None:
        """A face in a frame, None where it is not seen or lies beyond the picture."""
        data = self.video.face_at(face, index)
        return data if data is not None and data.score > 0 and min(self._box(data)[2:]) > 0 else None

    def _box(self, data: FaceInFrame) -> Box:
        size = (self.video.media.width, self.video.media.height)
        outline = data.landmarks.oval
        low = np.clip(np.floor(outline.min(axis=0)), 0, size).astype(int)
        high = np.clip(np.ceil(outline.max(axis=0)), 0, size).astype(int)
        return int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])
