"""Subtitles from the source clip into a new one: packets copied, or text written in the container's own kind."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import av
import av.container
from av.subtitles.subtitle import SubtitleSet

from pvg.video.audio import stamped
from pvg.video.carrying import CarriedTrack, StampedPacket
from pvg.video.keeping import Carried

_STEP = Fraction(1, 1000)  # of the containers' subtitles


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
        for packet in opened.demux(self._source):
            if not packet.size:
                continue
            if self.carried.encoder is None:
                yield stamped(packet)
            else:
                yield from self._converted(packet)

    def _converted(self, packet: Any) -> Iterator[StampedPacket]:
        shown = self._source.codec_context.decode2(packet)
        lines = [] if shown is None else [rect.ass for rect in shown if hasattr(rect, "ass")]
        if not lines or packet.pts is None:
            return  # a gap, which MP4's tracks have between lines
        start = packet.pts * packet.time_base
        length_ms = round((packet.duration or 0) * packet.time_base / _STEP)
        for line in lines:
            written = SubtitleSet.create(line, 0, length_ms, pts=round(start * 1_000_000))
            coded = self._target.codec_context.encode_subtitle(written)
            coded.time_base = _STEP
            coded.pts = coded.dts = round(start / _STEP)
            coded.duration = length_ms
            yield start, coded
