"""When a clip shows its frames, told by its packets without decoding: frames by time, and where decoding may begin.

Not all containers tell; frames are then found by decoding all before them, see `reading`.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from pathlib import Path

import av.error

from pvg.errors import MediaError
from pvg.video.file_state import FileState, file_state
from pvg.video.opening import MediaLimits, open_clip, reason
from pvg.video.sniffing import IMAGE_KINDS, sniff

_ROUNDING_S = 1e-3


@dataclass(frozen=True)
class DisplayOrder:
    """When a clip shows its frames.

    stamps: the time stamps of all frames, ascending;  keys: those of the pictures that decoding may begin at;
    time_base: seconds a tick.
    """

    stamps: tuple[int, ...]
    keys: tuple[int, ...]
    time_base: Fraction


def packet_stamps(path: Path, limits: MediaLimits) -> tuple[list[tuple[int | None, bool]], Fraction]:
    """(pts, is key) of every displayed packet of a clip in file order, without decoding, and the time base.

    None stands for the time stamp of a packet that has none of display.
    """
    with open_clip(path, limits) as clip:
        unknown = clip.stamps_are_of_coding
        try:
            packets = [
                (None if unknown else packet.pts, packet.is_keyframe) for packet in clip.packets() if clip.shows(packet)
            ]
        except av.error.FFmpegError as error:
            raise MediaError(f"{clip.name} is damaged ({reason(error)}); upload it again") from error
        return packets, clip.time_base


def display_order(path: Path, limits: MediaLimits, frame_count: int | None) -> DisplayOrder | None:
    """The clip's display order by its packets, or None where packets do not tell it.

    frame_count: how many frames the clip gives, where that is known.
    """
    order = _cached_order(path.absolute(), file_state(path), limits)
    return order if order is not None and frame_count in (None, len(order.stamps)) else None


def key_pictures(
    path: str | Path, limits: MediaLimits | None = None, *, frame_count: int | None = None
) -> tuple[int, ...] | None:
    """The numbers of the frames of a clip that decoding may begin at, ascending; (0,) for a picture.

    None where packets do not tell: every frame is then reached by decoding all before it.  frame_count: see
    `reading.read_frames`. Raises MediaError.
    """
    path = Path(path)
    if sniff(path) in IMAGE_KINDS:
        return (0,)
    order = display_order(path, limits or MediaLimits(), frame_count)
    return None if order is None else tuple(bisect_left(order.stamps, key) for key in order.keys)


def frame_at(
    path: str | Path, time_s: float, limits: MediaLimits | None = None, *, frame_count: int | None = None
) -> int | None:
    """The number of the frame that a clip shows so many seconds after its first one; the last one at and past its end.

    None where packets do not tell.  frame_count: see `reading.read_frames`. Raises MediaError.
    """
    path = Path(path)
    if sniff(path) in IMAGE_KINDS:
        return 0
    order = display_order(path, limits or MediaLimits(), frame_count)
    if order is None or not order.stamps:
        return None
    # a time that was worked out from a frame's number or stamp is that frame's in spite of its rounding
    ticks = order.stamps[0] + (time_s + _ROUNDING_S) / float(order.time_base)
    return max(0, bisect_right(order.stamps, ticks) - 1)


@lru_cache(maxsize=8)
def _cached_order(path: Path, state: FileState, limits: MediaLimits) -> DisplayOrder | None:
    packets, time_base = packet_stamps(path, limits)
    stamps = [pts for pts, _ in packets if pts is not None]
    if len(stamps) != len(packets) or len(set(stamps)) != len(stamps):
        return None
    # pictures shown before the first key picture lean on others that are cut away, and decoders may skip them
    if stamps and min(stamps) < next((pts for pts, key in packets if key and pts is not None), min(stamps)):
        return None
    keys = tuple(sorted(pts for pts, key in packets if key and pts is not None))
    return DisplayOrder(tuple(sorted(stamps)), keys, time_base)
