"""What each picture of a clip says of itself, though the clip is read as its first one says."""

from __future__ import annotations

from dataclasses import dataclass

import av.video.frame

from pvg.video.formats import UNSTATED

_RANGE = 3  # its place among the colour tags


@dataclass(frozen=True)
class Stated:
    """Of one picture.

    colors: code points of matrix, primaries, transfer and range;  interlaced: whether it is coded in fields.
    """

    colors: tuple[int, ...]
    interlaced: bool

    @classmethod
    def of(cls, picture: av.video.frame.VideoFrame) -> Stated:
        """What a decoded picture states."""
        colors = picture.colorspace, picture.color_primaries, picture.color_trc, picture.color_range
        return cls(colors, picture.interlaced_frame)

    def change_to(self, other: Stated) -> str | None:
        """How a later picture differs, in words; what either does not state, and a change to progressive, are none."""
        for k, (was, now) in enumerate(zip(self.colors, other.colors, strict=True)):
            unstated = (0,) if k == _RANGE else UNSTATED
            if was != now and was not in unstated and now not in unstated:
                return "changes its colour tags"
        return "changes from progressive to interlaced" if other.interlaced and not self.interlaced else None
