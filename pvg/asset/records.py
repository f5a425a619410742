"""What an asset tells of a clip and its faces."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Bools, Floats
from pvg.face import Landmarks
from pvg.skin import Matte
from pvg.video import MediaInfo


@dataclass(frozen=True)
class MediaSummary:
    """What the source is, as shown to people; see `pvg.video.MediaInfo` for all a file says of itself.

    kind: "video" or "image";  width, height: upright pixels;  frame_rate: average, frames a second, None for images;
    frame_count: of the clip, of a reference those that were looked at;
    rotation: clockwise degrees that made the stored picture upright;  color: how its colours were read, "SDR" or by
    name;  color_primaries, color_transfer: code points of ISO/IEC 23091-2 (2: not stated);
    warnings: what of the file is not read, a line each.
    """

    kind: str
    width: int
    height: int
    frame_rate: float | None
    frame_count: int
    duration_s: float
    codec: str
    pixel_format: str
    has_audio: bool
    rotation: int
    color: str = "SDR"
    color_primaries: int = 2
    color_transfer: int = 2
    warnings: tuple[str, ...] = ()

    @classmethod
    def of(cls, media: MediaInfo, frame_count: int) -> MediaSummary:
        """The summary of a file of which `frame_count` frames were read."""
        return cls(
            kind=media.kind,
            width=media.width,
            height=media.height,
            frame_rate=None if media.frame_rate is None else round(float(media.frame_rate), 3),
            frame_count=frame_count,
            duration_s=round(media.duration_s, 3),
            codec=media.codec,
            pixel_format=media.pixel_format,
            has_audio=media.has_audio,
            rotation=media.rotation,
            color=media.color,
            color_primaries=media.color_primaries,
            color_transfer=media.color_transfer,
            warnings=media.warnings,
        )


@dataclass(frozen=True)
class FaceSummary:
    """One tracked face of a clip, as shown to people.

    width_px: median of the longer extent of its contour, in x or y, source pixels, over the frames that show it;
    skin_rgb: median colour of its skin curves in the key frame, 0-255;
    person: who it is, as far as can be told; faces of one person are never seen at the same time.
    """

    index: int
    first_frame: int
    last_frame: int
    width_px: float
    skin_rgb: tuple[int, int, int]
    person: int
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class KeyFrame:
    """The boundary colours of one key frame: eq. (3) solved there.

    frame: frame number in the clip;  colors: (S, 3) float32 g, 0-255 RGB, on the table's labels;
    visible: (S,) bool, whether the sample lay on visible skin or a visible feature;
    skin: (N, 3) float32, colours of the open skin evenly over the face, N = 0 when there is too little of it;
    skin_at: (N,) int16, the sample of the table's labels on a skin curve nearest to each of them;
    parts: (P, 3) float32, median colour of each of `pvg.face.parts.PARTS`, NaN where it is not seen;
    since: the last frame that the key frame before it serves alone, from where the colours go over to this one's; None
    when they do so at once, at `frame`.
    """

    frame: int
    colors: Floats
    visible: Bools
    skin: Floats
    skin_at: NDArray[np.int16]
    parts: Floats
    since: int | None = None

    @cached_property
    def skin_median(self) -> Floats:
        """(3,) float32 the median of the open skin, of which there is some; all frames ask for it."""
        return np.asarray(np.median(self.skin, axis=0), np.float32)


@dataclass(frozen=True, eq=False)
class FaceInFrame:
    """One face in one frame.

    landmarks: source pixels;  boundary: (192, 2) mask boundary samples, source pixels;
    score: face score in [0, 1], 0 where the face is not seen;  pose: (3,) yaw, pitch, roll in degrees;
    matte: its skin;  body: all other skin of the person, over the whole picture.
    """

    landmarks: Landmarks
    boundary: Floats
    score: float
    pose: Floats
    matte: Matte
    body: Matte


@dataclass(frozen=True, eq=False)
class FaceRecord:
    """A face of the clip: what it is, and its key frames.

    haze: levels of it over its pictures, see `pvg.haze`;  warmth: of what is around it, see `pvg.warmth`.
    """

    summary: FaceSummary
    key_frames: tuple[KeyFrame, ...]
    haze: int = 0
    warmth: int = 0

    def key_frame_of(self, frame: int) -> KeyFrame:
        """The key frame last passed at `frame`: the last one at or before it, else the first."""
        return self.key_frames[self._passed(frame)]

    def keys_at(self, frame: int) -> tuple[int, int, float]:
        """The key frames that serve `frame`, by number, and the share of the second: g = (1 − share) g₁ + share g₂.

        Between two key frames the colours go over linearly, as the light did that asked for the second one.
        """
        first = self._passed(frame)
        second = min(first + 1, len(self.key_frames) - 1)
        after = self.key_frames[second]
        if after.since is None or frame <= after.since or frame >= after.frame:
            return first, first, 0.0
        return first, second, (frame - after.since) / (after.frame - after.since)

    def blended(self, tables: Sequence[Floats] | Floats, frame: int) -> Floats:
        """What serves `frame` of something known at every key frame, blended between two of them.

        tables: (K, …), or K arrays of one shape (…), which is the result's.
        """
        first, second, share = self.keys_at(frame)
        if first == second:
            return tables[first]
        return np.asarray(tables[first] + np.float32(share) * (tables[second] - tables[first]), np.float32)

    def served(self) -> tuple[float, ...]:
        """How many of the face's frames each key frame serves, those between two of them by their shares."""
        later, face = self.key_frames[1:], self.summary
        # the shares of the frames between `since` and `frame` add up to half of their number
        begins = (key.frame if key.since is None else (key.since + 1 + key.frame) / 2 for key in later)
        ends = [float(face.first_frame), *begins, face.last_frame + 1.0]
        return tuple(stop - start for start, stop in itertools.pairwise(ends))

    def _passed(self, frame: int) -> int:
        return max((k for k, key in enumerate(self.key_frames) if key.frame <= frame), default=0)
