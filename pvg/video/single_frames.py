"""Single frames of a clip in any order: decoders stay where they stopped, and go on from there.

Decoding a frame begins at the key picture before it, hundreds of pictures away where a clip has few of them. Whoever
asks for one frame asks for others: from a decoder that stands before them the way is shorter, and neither is the
container opened again nor its first picture decoded.
"""

from __future__ import annotations

import os
from bisect import bisect_right
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from threading import RLock
from typing import Final
from weakref import WeakSet

import av.error
import av.video.frame

from pvg.errors import MediaError
from pvg.video.decoding import DecodingPlan, decoding_plan, to_frame, within_depth
from pvg.video.display_order import DisplayOrder, display_order
from pvg.video.file_state import FileState, file_state
from pvg.video.formats import Frame
from pvg.video.opening import MediaLimits, open_clip
from pvg.video.reading import check_picture, pictures
from pvg.video.sniffing import IMAGE_KINDS, sniff

_MOST: Final = 3  # decoders of a clip [to frames at random the way is 31 of 200; 41 with two, 27 with four]
_KEPT_BYTES: Final = 200_000_000  # of their pictures: three decoders at 1920x1080, one at 3840x2160
_HELD: Final = 16  # pictures that a decoder with its threads holds at most [measured: H.264 14 to 16, AV1 16, HEVC 10]
_NOWHERE, _NEVER = -(1 << 62), 1 << 62  # before and after all time stamps


@dataclass
class _Goal:
    """The time stamp that a decoder is on its way to."""

    stamp: int


class _Decoder:
    """A clip that is open at the frame that it gave last."""

    def __init__(self, path: Path, limits: MediaLimits) -> None:
        self._goal, self._opened = _Goal(_NOWHERE), ExitStack()
        self._clip = self._opened.enter_context(open_clip(path, limits))
        self._pictures = self._following()
        self._next: int | None = None
        self.frame: Frame | None = None

    def _following(self) -> Iterator[av.video.frame.VideoFrame]:
        # what is on its way was decoded for an earlier goal, with all that is shown after that
        goal = self._goal
        return pictures(self._clip, since=lambda: goal.stamp)

    @property
    def at(self) -> int:
        """The time stamp of the frame that it gave last."""
        return _NOWHERE if self.frame is None else self.frame.pts

    def plan(self, input_color: str) -> DecodingPlan:
        """How the clip looks, by its first picture. Raises MediaError where there is none."""
        opening = next(self._pictures, None)
        if opening is None:
            raise MediaError(f"{self._clip.name} holds no frame that can be decoded")
        self._pictures, self._next = chain((opening,), self._pictures), opening.pts
        return decoding_plan(self._clip, opening, input_color)

    def turn_to(self, key: int) -> None:
        """Go to the key picture with this time stamp, if that does not come next."""
        if self._next == key:
            return
        self.frame, self._next = None, None
        self._clip.seek(key)
        self._pictures = self._following()

    def frame_at(self, index: int, stamp: int, plan: DecodingPlan, limits: MediaLimits) -> Frame:
        """Frame `index`, shown at `stamp`, where it stands or after it. Raises MediaError where it is not met."""
        if self.frame is not None and self.frame.pts == stamp:
            return self.frame
        self._goal.stamp, self._next = stamp, None
        picture = next((one for one in self._pictures if one.pts is None or one.pts >= stamp), None)
        if picture is None or picture.pts != stamp:
            raise MediaError(f"{self._clip.name} does not lead to its frame {index}")
        check_picture(self._clip.name, picture, plan, index, limits)
        self.frame = within_depth(self._clip.name, to_frame(picture, plan, index, stamp, self._clip.time_base))
        return self.frame

    def close(self) -> None:
        """Close the clip. The decoder's threads end with the last reference to it."""
        self._pictures, self.frame = iter(()), None
        self._opened.close()
        del self._clip


@dataclass(frozen=True)
class _Clip:
    """A file as it was when its decoders were opened, and how it is read: another one in its place is told from it."""

    path: Path
    state: FileState
    limits: MediaLimits
    input_color: str

    @classmethod
    def of(cls, path: Path, limits: MediaLimits, input_color: str) -> _Clip:
        return cls(path.absolute(), file_state(path), limits, input_color)


class _Kept:
    """The decoders of one clip that are not at work, each at a frame; how the clip looks, once that is known."""

    def __init__(self, clip: _Clip) -> None:
        self.clip = clip
        self.plan: DecodingPlan | None = None
        self.decoders: list[_Decoder] = []
        self._most = _MOST

    def take(self, key: int, stamp: int, order: DisplayOrder) -> _Decoder | None:
        """The decoder that stands nearest before the frame shown at `stamp`, after its key picture.

        Else the one that is needed least, if no more are to be kept, or None: a further one is to be opened.
        """
        nearest = max((one for one in self.decoders if key <= one.at <= stamp), key=lambda one: one.at, default=None)
        if nearest is None and self.decoders and len(self.decoders) >= self._most:
            nearest = self._least_needed(order)
        if nearest is not None:
            self.decoders.remove(nearest)
        return nearest

    def put_back(self, decoder: _Decoder, frame: Frame, order: DisplayOrder) -> list[_Decoder]:
        """Keep a decoder that gave a frame; those that are to be closed for it."""
        self._most = min(_MOST, _KEPT_BYTES // (_HELD * sum(plane.nbytes for plane in frame.planes)))
        self.decoders.append(decoder)
        spare = []
        while len(self.decoders) > self._most:
            spare.append(self._least_needed(order))
            self.decoders.remove(spare[-1])
        return spare

    def close(self) -> None:
        """Close the decoders."""
        while self.decoders:
            self.decoders.pop().close()

    def _least_needed(self, order: DisplayOrder) -> _Decoder:
        """The decoder that shortens the way to frames at random least."""
        starts = sorted({*order.keys, *(one.at for one in self.decoders)})

        def saved(one: _Decoder) -> int:
            """How long the clip is that begins at it, times how far the place before is, from which to decode else."""
            place = bisect_right(starts, one.at)
            before, after = starts[max(0, place - 2)], (*starts, order.stamps[-1] + 1)[place]
            return (one.at - before) * (after - one.at)

        return min(self.decoders, key=saved)


class SingleFrames:
    """Gives single frames of a clip, in any order and to any thread, by decoders that stay open for the next ones.

    Up to three are kept, fewer of large pictures and none of the largest, so that they take 200 MB at most.
    Those that are not at work are closed by `close`, where another clip is asked for, and before this process forks,
    which their threads do not survive.
    """

    def __init__(self) -> None:
        # by one thread more than once: garbage that is collected while it is had may be a `VectorVideo`, which closes
        self._lock = RLock()
        self._kept: _Kept | None = None
        with _forks:
            _all.add(self)

    def frame(
        self,
        path: str | Path,
        index: int,
        *,
        limits: MediaLimits | None = None,
        input_color: str = "auto",
        frame_count: int | None = None,
    ) -> Frame | None:
        """The frame that `read_frames` gives with `start=index` and these options, or None where it is to be asked.

        That is so of pictures, of clips whose packets do not tell the order of frames, and wherever something is wrong
        with the clip, the options or the number: it says what.
        """
        path, limits = Path(path), limits or MediaLimits()
        try:
            order = None if sniff(path) in IMAGE_KINDS else display_order(path, limits, frame_count)
            if order is None or not 0 <= index < len(order.stamps):
                return None
            if order.stamps[index] < min(order.keys, default=_NEVER):
                return None
            return self._decoded(_Clip.of(path, limits, input_color), index, order)
        except (MediaError, av.error.FFmpegError):
            return None

    def close(self) -> None:
        """Close the decoders that are not at work. More may be asked for afterwards."""
        with self.halted():
            pass

    @contextmanager
    def halted(self) -> Iterator[None]:
        """Close the decoders that are not at work; none is taken or kept while the block lasts."""
        with self._lock:
            if self._kept is not None:
                self._kept.close()
            self._kept = None  # and no other variable: what is referred to across a fork still has its threads
            yield

    def _decoded(self, clip: _Clip, index: int, order: DisplayOrder) -> Frame:
        stamp, kept = order.stamps[index], self._kept_of(clip)
        key = order.keys[bisect_right(order.keys, stamp) - 1]
        with self._lock:
            decoder = kept.take(key, stamp, order)
        if decoder is None:
            decoder = _Decoder(clip.path, clip.limits)
        try:
            if kept.plan is None:
                kept.plan = decoder.plan(clip.input_color)
            if not key <= decoder.at <= stamp:
                decoder.turn_to(key)
            frame = decoder.frame_at(index, stamp, kept.plan, clip.limits)
        except BaseException:
            decoder.close()
            raise
        with self._lock:
            spare = kept.put_back(decoder, frame, order) if self._kept is kept else [decoder]
        for one in spare:
            one.close()
        return frame

    def _kept_of(self, clip: _Clip) -> _Kept:
        """What is kept of a clip; what was kept of another one is closed."""
        with self._lock:
            before = self._kept
            if before is not None and before.clip == clip:
                return before
            self._kept = now = _Kept(clip)
            if before is not None:
                before.close()
            return now


_all: WeakSet[SingleFrames] = WeakSet()
_forks = RLock()  # one fork after the other; while one is made, no `SingleFrames` is
_halted: list[ExitStack] = []


def _halt() -> None:
    """Before a fork: close what is kept, and keep nothing more until it is done."""
    _forks.acquire()
    halted = ExitStack()
    _halted.append(halted)
    for one in tuple(_all):
        halted.enter_context(one.halted())


def _go_on() -> None:
    """After a fork, in both processes."""
    if _halted:  # none where this was imported after the fork had begun
        _halted.pop().close()
        _forks.release()


os.register_at_fork(before=_halt, after_in_parent=_go_on, after_in_child=_go_on)
