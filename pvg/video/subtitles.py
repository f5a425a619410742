"""Subtitles from the source clip into a new one: packets copied, or text written in the container's own kind."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain
from typing import Any

import av
import av.container
from av.subtitles.subtitle import SubtitleSet

from pvg.video.audio import with_due_time
from pvg.video.carrying import CarriedTrack, StampedPacket
from pvg.video.plan import Carried

_STEP = Fraction(1, 1000)  # of the containers' subtitles
_FIELDS = 8  # of an event before its text


@dataclass(frozen=True)
class Line:
    """Text that is seen from `start_ms` to before `end_ms`, as an event of ASS as libav has them (without times)."""

    start_ms: int
    end_ms: int
    event: bytes


class SubtitleTrack(CarriedTrack):
    """One subtitle track of the source, at its own times."""

    what = "subtitle track"
    instead = "take it out of the clip, or upload it again"

    def _add_stream(self, output: av.container.OutputContainer, carried: Carried) -> Any:
        if carried.encoder is None:
            return output.add_stream_from_template(self._source)
        decoder = self._source.codec_context
        decoder.open()  # which writes the head of styles that encoders ask for
        stream: Any = output.add_stream(carried.encoder)
        stream.codec_context.time_base = _STEP
        stream.codec_context.subtitle_header = decoder.subtitle_header
        return stream

    def _produce(self, opened: av.container.InputContainer) -> Iterator[StampedPacket]:
        packets = (packet for packet in opened.demux(self._source) if packet.size)
        if self.carried.encoder is None:
            yield from map(with_due_time, packets)
            return
        lines = (line for packet in packets for line in self._lines(packet))
        for line in one_at_a_time(lines) if self.carried.encoder == "mov_text" else lines:
            written = SubtitleSet.create(line.event, 0, line.end_ms - line.start_ms, pts=line.start_ms * 1000)
            coded = self._target.codec_context.encode_subtitle(written)
            coded.time_base = _STEP
            coded.pts = coded.dts = line.start_ms
            coded.duration = line.end_ms - line.start_ms
            yield line.start_ms * _STEP, coded

    def _lines(self, packet: Any) -> Iterator[Line]:
        shown = self._source.codec_context.decode2(packet)
        events = [] if shown is None else [rect.ass for rect in shown if hasattr(rect, "ass")]
        if not events or packet.pts is None:
            return  # a gap, which MP4's tracks have between lines
        start, length = (round(ticks * packet.time_base / _STEP) for ticks in (packet.pts, packet.duration or 0))
        for event in events:
            yield Line(start, start + length, event)


def one_at_a_time(lines: Iterable[Line]) -> Iterator[Line]:
    """The same text as lines of which none begins before the one before has ended: MP4's tracks show one at a time.

    Where several are to be seen at once, they are the lines of one.  lines: by their starts, as containers have them.
    """
    at_ms, seen = 0, list[Line]()
    for line in chain(lines, [None]):
        until_ms = None if line is None else line.start_ms
        while seen and (until_ms is None or at_ms < until_ms):
            end_ms = min([one.end_ms for one in seen] + ([] if until_ms is None else [until_ms]))
            if end_ms > at_ms:
                yield Line(at_ms, end_ms, _together(seen))
            at_ms, seen = max(at_ms, end_ms), [one for one in seen if one.end_ms > end_ms]
        if line is not None:
            at_ms, seen = max(at_ms, line.start_ms), [*seen, line]


def _together(lines: Sequence[Line]) -> bytes:
    return rb"\N".join([lines[0].event, *(line.event.split(b",", _FIELDS)[-1] for line in lines[1:])])
