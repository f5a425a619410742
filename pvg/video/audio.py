"""Sound from the source clip into a new one: packets copied, or transcoded where the container cannot hold them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fractions import Fraction
from typing import Any

import av
import av.audio.stream
import av.container
import av.filter
import av.packet

from pvg.video.carrying import CarriedTrack, StampedPacket
from pvg.video.containers import has_edits
from pvg.video.opening import is_left_out
from pvg.video.plan import Carried
from pvg.video.sound_formats import sound_shape
from pvg.video.steady import samples_of_packets, steady_frames, steady_packets, steady_pcm
from pvg.video.streams import Track

#: seconds before the first packet that is played of which codecs may need packets: Opus wants 0.08
_LEAD_IN_S = Fraction(1, 10)


class SoundTrack(CarriedTrack):
    """One sound track of the source. Time stamps keep the source's origin, so sound and picture stay in step."""

    what = "sound"
    instead = "render without sound or upload it again"

    def _add_stream(self, output: av.container.OutputContainer, carried: Carried) -> Any:
        template: Any = self._source
        if carried.encoder is None:
            return output.add_stream_from_template(template)
        rate, layout = sound_shape(carried.track, carried.encoder)
        stream: Any = output.add_stream(carried.encoder, rate=rate)
        stream.codec_context.layout = layout
        if not carried.encoder.startswith("pcm_"):
            stream.codec_context.bit_rate = 64_000 * max(1, stream.codec_context.layout.nb_channels)
        return stream

    def lead_s(self) -> Fraction:
        """How long before zero it begins, beyond what the container itself tells a decoder to skip."""
        if self.carried.encoder is not None:
            return Fraction(0)
        head: bytes = b"" if self._container == "nut" else self._source.codec_context.extradata or b""
        skipped = int.from_bytes(head[10:12], "little") if head.startswith(b"OpusHead") else 0
        return max(Fraction(0), -self.begins_s() - Fraction(skipped, 48000))

    def _produce(self, opened: av.container.InputContainer) -> Iterator[StampedPacket]:
        packets = opened.demux(self._source)
        if self.carried.encoder is None:
            played = _within_edit_list(opened, packets, tells_lead_in=has_edits(self._container))
            yield from map(with_due_time, self._copied(played))
            return
        for frame in steady_frames(self._decoded(packets)):
            for coded in self._target.encode(frame):
                yield with_due_time(coded)
        for coded in self._target.encode(None):
            yield with_due_time(coded)

    def _copied(self, packets: Iterator[av.packet.Packet[Any]]) -> Iterator[av.packet.Packet[Any]]:
        """Packets in the even steps that MP4 and MOV can tell."""
        track = self.carried.track
        if self._container == "mov" and track.codec.startswith("pcm_"):
            return steady_pcm(packets, track)
        context = self._source.codec_context
        samples = samples_of_packets(track, context.frame_size, context.extradata or b"")
        rounded = has_edits(self._container) and self._source.time_base > Fraction(1, track.rate or 1)
        return steady_packets(packets, samples, track.rate) if rounded and samples else packets

    def _decoded(self, packets: Iterable[av.packet.Packet[Any]]) -> Iterator[Any]:
        """The sound itself, the channels in the order of their layout."""
        track, sorter = self.carried.track, None
        if track.order:  # PyAV frees the list of channels in this order twice: frames are to come without it
            self._source.codec_context.layout = f"{track.channels} channels"
        for packet in packets:
            for frame in packet.decode():
                if track.order and track.codec.startswith("pcm_") and not track.layout.endswith(" channels"):
                    sorter = sorter or _sorter(frame, track)
                    sorter.push(frame)
                    yield sorter.pull()
                else:
                    yield frame


def _sorter(frame: Any, track: Track) -> av.filter.Graph:
    """Gives the channels of a track's frames in the order of their layout."""
    graph = av.filter.Graph()
    source = graph.add_abuffer(
        sample_rate=frame.sample_rate, format=frame.format.name, layout=frame.layout.name, time_base=frame.time_base
    )
    places = "|".join(f"{k}-{name}" for k, name in enumerate(track.order))
    sorts = graph.add("channelmap", f"map={places}:channel_layout={track.layout}")
    graph.link_nodes(source, sorts, graph.add("abuffersink")).configure()
    return graph


def _within_edit_list(
    opened: av.container.InputContainer, packets: Iterable[av.packet.Packet[Any]], *, tells_lead_in: bool
) -> Iterator[av.packet.Packet[Any]]:
    """The packets that the source's edit list plays, after those that the decoder needs first; no time steps back.

    tells_lead_in: whether the new clip can mark those first packets as not to be played. Where it cannot only the last
    of them is kept, which most codecs need, and it is played.
    Left out are the first packets of a second edit, whose times lie in the edit before. Equal times are kept: packets
    may be shorter than a tick, as TrueHD's in Matroska.
    """
    begun, last, held = False, None, None
    for packet in packets:
        left_out = is_left_out(packet, opened)
        if not packet.size or (left_out and (begun or _is_before_lead_in(packet))):
            continue
        if packet.dts is not None:
            if last is not None and packet.dts < last:
                continue
            last = packet.dts
        begun = begun or not left_out
        if not begun and not tells_lead_in:
            held = packet
            continue
        if held is not None:
            yield held
            held = None
        yield packet


def _is_before_lead_in(packet: av.packet.Packet[Any]) -> bool:
    """Whether a packet that is not played ends so early that no decoder needs it for what is."""
    if packet.pts is None:
        return False
    return (packet.pts + (packet.duration or 0)) * packet.time_base < -_LEAD_IN_S


def with_due_time(packet: av.packet.Packet[Any]) -> StampedPacket:
    """A packet and when it is due."""
    stamp = packet.dts if packet.dts is not None else packet.pts or 0
    return Fraction(stamp * packet.time_base), packet
