"""Parts of a clip as files: the coded packets of some of its frames, exactly as an encoder gave them.

No container keeps them so: NUT has no decode time stamps, Matroska counts milliseconds, MP4 rewrites the packets of
H.264 and HEVC and takes no FFV1. A part therefore is its own plain kind of file (numbers are little-endian):

    magic, length of the head (u32), head (JSON)
    of each packet in coding order: "P", pts, dts, duration (3 × i64), whether a key picture (u8), length (u32), bytes
    "E", pts of each frame in order of display (i64), end of the last (i64), delay, frames (2 × u32)
    SHA-256 of all before
"""

from __future__ import annotations

import hashlib
import io
import json
import struct
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import av
import av.packet

from pvg.errors import MediaError, PartError
from pvg.video.encoding import CodedPacket, PictureEncoder, reordering_delay
from pvg.video.formats import Frame, Patch

_MAGIC = b"PVGPART1"
_LENGTH, _PACKET, _END = struct.Struct("<I"), struct.Struct("<qqqBI"), struct.Struct("<qII")
_MOST_HEAD_BYTES = 65536
_IS_PACKET, _IS_END = b"P", b"E"


@dataclass(frozen=True)
class ClipOfParts:
    """What all parts of a clip have in common, beside their encoder.

    source_sha256, frame_count: of the clip. crf, preset: as asked for. made_by: versions of what draws and codes, so
    that no join mixes two.
    """

    source_sha256: str
    frame_count: int
    crf: int | None
    preset: str | None
    made_by: str


@dataclass(frozen=True)
class PartHead(ClipOfParts):
    """What a part is of, and how it is coded.

    start, stop: its frames. time_base: (numerator, denominator) of a tick in seconds. codec, layout, width, height,
    alpha, fields: of the pictures, see `Plan`. head: the encoder's, in hexadecimal.
    """

    start: int
    stop: int
    time_base: tuple[int, int]
    codec: str
    layout: str
    width: int
    height: int
    alpha: bool
    fields: str | None
    head: str


def head_of(clip: ClipOfParts, encoder: PictureEncoder, start: int, stop: int) -> PartHead:
    """The head of a part of frames [start, stop) that an encoder makes, once it has its stream."""
    base, plan = encoder.time_base, encoder.plan
    return PartHead(
        **asdict(clip),
        start=start,
        stop=stop,
        time_base=(base.numerator, base.denominator),
        codec=plan.codec,
        layout=plan.format.name,
        width=plan.width,
        height=plan.height,
        alpha=plan.alpha,
        fields=plan.fields,
        head=encoder.head().hex(),
    )


class PartWriter:
    """Writes frames [start, stop) of a clip as a part; a context manager like `VideoWriter`.

    encoder: one made with `part`. Raises ValueError for another number of frames than stop - start, MediaError when
    encoding fails.
    """

    def __init__(self, path: Path, encoder: PictureEncoder, clip: ClipOfParts, *, start: int, stop: int) -> None:
        self.path, self._encoder, self._clip = path, encoder, clip
        self._start, self._stop = start, stop
        self._digest, self._coded, self._whole = hashlib.sha256(), list[int](), False

    def __enter__(self) -> PartWriter:
        with ExitStack() as stack:
            # never written: its container's kind alone says what packets are to be like
            unwritten = stack.enter_context(av.open(io.BytesIO(), "w", format=self._encoder.plan.container))
            self._encoder.stream_of(unwritten)
            head = head_of(self._clip, self._encoder, self._start, self._stop)
            text = json.dumps(asdict(head), sort_keys=True).encode()
            self._file = self.path.open("wb")
            stack.callback(self._remove_draft)
            stack.enter_context(self._file)
            self._put(_MAGIC + _LENGTH.pack(len(text)) + text)
            self._opened = stack.pop_all()
        return self

    def _remove_draft(self) -> None:
        if not self._whole:
            self.path.unlink(missing_ok=True)

    @property
    def _count(self) -> int:
        return self._stop - self._start

    def _put(self, data: bytes) -> None:
        self._file.write(data)
        self._digest.update(data)

    def write(self, frame: Frame, patches: Sequence[Patch] = ()) -> None:
        """Encode one frame, as `VideoWriter.write`."""
        self._add(self._encoder.encode(frame, patches, closing=self._encoder.frames == self._count - 1))

    def _add(self, packets: Sequence[CodedPacket]) -> None:
        for packet in packets:
            if packet.pts is None or packet.dts is None or packet.time_base != self._encoder.time_base:
                raise MediaError(f"{self.path.name}: the encoder leaves out time stamps; choose another codec")
            data = bytes(packet)
            fields = packet.pts, packet.dts, packet.duration or 0, packet.is_keyframe, len(data)
            self._put(_IS_PACKET + _PACKET.pack(*fields))
            self._put(data)
            self._coded.append(packet.pts)

    def _put_end(self) -> None:
        stamps = sorted(self._coded)
        self._put(_IS_END + struct.pack(f"<{len(stamps)}q", *stamps))
        self._put(_END.pack(self._encoder.end_pts, reordering_delay(self._coded), len(stamps)))
        self._file.write(self._digest.digest())

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._opened:
            if kind is not None:
                return
            if self._encoder.frames != self._count:
                raise ValueError(f"{self.path.name} has {self._encoder.frames} frames of {self._count}")
            self._add(self._encoder.rest())
            self._put_end()
            self._file.close()  # on a full disk even closing raises
            self._whole = True


class PartReader:
    """Reads a part; a context manager.

    head: what it is of. stamps: the time stamps of its frames in order of display, end: where the last one ends, in
    ticks. delay: by how many places a packet stands behind its frame's at most. Raises PartError for a file that is
    missing, no part, altered or cut short; at the end of `packets` at the latest, which compares all bytes.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._digest = hashlib.sha256()

    def __enter__(self) -> PartReader:
        try:
            self._file: BinaryIO = self.path.open("rb")
        except OSError as error:
            raise PartError(f"{self.path.name}: the part cannot be read ({error.strerror}); draw it again") from error
        try:
            self._size = self.path.stat().st_size
            self.head = self._read_head()
            self.stamps, self.end, self.delay = self._read_end()
        except BaseException:
            self._file.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def _damaged(self, how: str) -> PartError:
        return PartError(f"{self.path.name}: the part is damaged ({how}); draw it again")

    def _take(self, count: int) -> bytes:
        if count > self._size - self._file.tell():
            raise self._damaged("it is cut short")
        data = self._file.read(count)
        if len(data) != count:
            raise self._damaged("it is cut short")
        self._digest.update(data)
        return data

    def _read_head(self) -> PartHead:
        if self._take(len(_MAGIC)) != _MAGIC:
            raise self._damaged("it does not begin as one")
        (length,) = _LENGTH.unpack(self._take(_LENGTH.size))
        if length > _MOST_HEAD_BYTES:
            raise self._damaged("its head is too long")
        try:
            facts = json.loads(self._take(length))
            head = PartHead(**(facts | {"time_base": tuple(facts["time_base"])}))
            if type(head.start) is not int or type(head.stop) is not int:
                raise TypeError("frames are counted in whole numbers")
        except (ValueError, TypeError, KeyError, RecursionError) as error:
            raise self._damaged("its head cannot be read") from error
        return head

    def _read_end(self) -> tuple[list[int], int, int]:
        """Stamps, end and delay, ahead of the packets."""
        begun, last = self._file.tell(), self._size - self._digest.digest_size - _END.size
        if last < begun:
            raise self._damaged("it is cut short")
        self._file.seek(last)
        end, delay, count = _END.unpack(self._file.read(_END.size))
        if count != self.head.stop - self.head.start or 8 * count > last - begun:
            raise self._damaged("it does not end with all of its frames")
        self._file.seek(last - 8 * count)
        stamps = list(struct.unpack(f"<{count}q", self._file.read(8 * count)))
        self._file.seek(begun)
        if any(later <= stamp for stamp, later in pairwise([*stamps, end])) or delay > count:
            raise self._damaged("its time stamps do not rise")
        return stamps, end, delay

    def packets(self) -> Iterator[CodedPacket]:
        """The packets in coding order, once."""
        coded, base = list[int](), Fraction(*self.head.time_base)
        while (kind := self._take(1)) == _IS_PACKET:
            pts, dts, duration, key, length = _PACKET.unpack(self._take(_PACKET.size))
            packet: Any = av.packet.Packet(self._take(length))
            packet.pts, packet.dts, packet.duration, packet.time_base = pts, dts, duration, base
            packet.is_keyframe = bool(key)
            yield packet
            coded.append(pts)
        if kind != _IS_END:
            raise self._damaged("what follows a packet is none")
        self._take(8 * len(self.stamps) + _END.size)
        digest = self._digest.digest()
        if self._take(len(digest)) != digest or self._file.read(1) or sorted(coded) != self.stamps:
            raise self._damaged("its bytes are not those that were written")
