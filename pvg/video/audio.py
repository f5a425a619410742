"""Sound from the source clip into a new one: packets copied, or transcoded where the container cannot hold them."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import av
import av.audio.stream
import av.container
import av.packet

from pvg.video.carrying import CarriedTrack, StampedPacket
from pvg.video.keeping import Carried

_USUAL_LAYOUTS = {1: "mono", 2: "stereo", 3: "2.1", 4: "quad", 5: "5.0", 6: "5.1", 7: "6.1", 8: "7.1"}


class SoundTrack(CarriedTrack):
    """One sound track of the source. Time stamps keep the source's origin, so sound and picture stay in step."""

    what = "sound"
    instead = "render without sound or upload it again"

    def _add_stream(self, output: av.container.OutputContainer, carried: Carried) -> Any:
        template: Any = self._source
        if carried.encoder is None:
            return output.add_stream_from_template(template)
        opus = carried.encoder == "libopus"
        rate = 48000 if opus else template.codec_context.sample_rate
        stream: Any = output.add_stream(carried.encoder, rate=rate)
        stream.codec_context.layout = _layout(template.codec_context.layout)
        if not carried.encoder.startswith("pcm_"):
            stream.codec_context.bit_rate = 64_000 * max(1, template.codec_context.layout.nb_channels)
        return stream

    def _produce(self, opened: av.container.InputContainer) -> Iterator[StampedPacket]:
        copies = self.carried.encoder is None
        for packet in opened.demux(self._source):
            if copies:
                if packet.size:
                    yield stamped(packet)
                continue
            for frame in packet.decode():
                for coded in self._target.encode(frame):
                    yield stamped(coded)
        if not copies:
            for coded in self._target.encode(None):
                yield stamped(coded)


def _layout(layout: Any) -> str:
    """libav's name of a channel layout; one that only counts its channels is taken for the usual one of that many."""
    name = str(layout.name)
    return _USUAL_LAYOUTS.get(layout.nb_channels, name) if name.endswith(" channels") else name


def stamped(packet: av.packet.Packet[Any]) -> StampedPacket:
    """A packet and when it is due."""
    stamp = packet.dts if packet.dts is not None else packet.pts or 0
    return Fraction(stamp * packet.time_base), packet
