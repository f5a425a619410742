"""Sound in even steps: time stamps of containers are rounded, to a millisecond in Matroska.

Coded packets that are copied are put where they are when that is no farther off than by rounding. For encoders, and for
PCM in MOV, which has no place for gaps, sound follows what came before without a seam as long as it is within
`_TOLERANCE_S` of its stamps, and gaps become silence.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from fractions import Fraction
from typing import Any

import av
import av.packet

from pvg.video.streams import Track

#: seconds that sound may be off its stamps to either side: by so many it may be early before it is noticed (EBU R 37)
_TOLERANCE_S = Fraction(1, 25)
#: seconds of silence in a track at most, as long as a clip may be: beyond it time stamps are taken for damaged, and
#: followed. A small file could ask for any amount of it
_MOST_SILENCE_S = 3600
#: bytes of PCM that stand for silence, where these are not 0
_SILENT = {"pcm_u8": 0x80, "pcm_mulaw": 0xFF, "pcm_alaw": 0xD5}
_LAW_BITS = 8
_OF_ONE_LENGTH = ("aac", "mp3", "mp3float", "mp2")
_SAMPLES_A_PACKET = {"ac3": 1536, "eac3": 1536}
#: where ALAC's atom of 36 bytes has the samples of a packet
_ALAC_FRAME = slice(12, 16)


class _Clock:
    """When the next sample of a track is due, in seconds; None before the first."""

    def __init__(self) -> None:
        self.due_s: Fraction | None = None
        self._filled_s = Fraction(0)

    def gap(self, stamped_s: Fraction | None, rate: int) -> int | None:
        """Samples of silence that come before sound of this stamp; None where it comes too late to be heard."""
        if self.due_s is None:
            self.due_s = Fraction(round((stamped_s or Fraction(0)) * rate), rate)
        ahead_s = Fraction(0) if stamped_s is None else stamped_s - self.due_s
        if ahead_s < -_TOLERANCE_S:
            return None
        if ahead_s <= _TOLERANCE_S:
            return 0
        if self._filled_s + ahead_s > _MOST_SILENCE_S:
            self.due_s += Fraction(round(ahead_s * rate), rate)
            return 0
        self._filled_s += ahead_s
        return round(ahead_s * rate)

    def stamp(self, item: Any, samples: int, rate: int) -> Any:
        """The frame or packet of so many samples, due now."""
        assert self.due_s is not None  # noqa: S101 - `gap` comes first
        item.pts, item.time_base = round(self.due_s * rate), Fraction(1, rate)
        self.due_s += Fraction(samples, rate)
        return item


def steady_frames(frames: Iterable[Any]) -> Iterator[Any]:
    """Decoded sound, each frame where the one before ends; what lies in the time of those before is left out."""
    clock = _Clock()
    for frame in frames:
        rate = frame.sample_rate
        gap = clock.gap(None if frame.pts is None else frame.pts * frame.time_base, rate)
        if gap is None:
            continue
        for samples in _in_seconds(gap, rate):
            yield clock.stamp(_silence(frame, samples), samples, rate)
        yield clock.stamp(frame, frame.samples, rate)


def _silence(like: Any, samples: int) -> Any:
    frame: Any = av.AudioFrame(like.format.name, like.layout, samples)
    frame.sample_rate = like.sample_rate
    silent = b"\x80" if like.format.name.startswith("u8") else b"\0"
    for plane in frame.planes:
        plane.update(silent * plane.buffer_size)
    return frame


def steady_pcm(packets: Iterable[av.packet.Packet[Any]], track: Track) -> Iterator[av.packet.Packet[Any]]:
    """The packets of a track of PCM in the same way."""
    clock, rate = _Clock(), track.rate
    bits = re.search(r"\d+", track.codec)
    width = track.channels * (_LAW_BITS if bits is None else int(bits[0])) // 8
    for packet in packets:
        gap = clock.gap(None if packet.pts is None else packet.pts * packet.time_base, rate)
        if gap is None:
            continue
        for samples in _in_seconds(gap, rate):
            silent = av.Packet(bytes([_SILENT.get(track.codec, 0)]) * (samples * width))
            yield _stamped(silent, samples, clock, rate)
        yield _stamped(packet, packet.size // width, clock, rate)


def samples_of_packets(track: Track, frame_size: int, extradata: bytes) -> int:
    """Samples in each packet of a codec whose packets are of one length but for the last, 0 of others.

    frame_size, extradata: libav's. ALAC's is in the latter alone, and Matroska does not tell how long its last packet
    is.
    """
    if track.codec == "alac":
        return int.from_bytes(extradata[_ALAC_FRAME], "big")
    return _SAMPLES_A_PACKET.get(track.codec, 0) or (frame_size if track.codec in _OF_ONE_LENGTH else 0)


def steady_packets(
    packets: Iterable[av.packet.Packet[Any]], samples: int, rate: int
) -> Iterator[av.packet.Packet[Any]]:
    """Coded packets of so many samples each: where the one before ends, if the stamp is that but for its rounding."""
    due_s: Fraction | None = None
    for packet in packets:
        if packet.pts is None or packet.pts != packet.dts:
            yield packet
            continue
        tick, length_s = packet.time_base, Fraction(samples, rate)
        stamped_s, stated_s = packet.pts * tick, (packet.duration or 0) * tick or length_s
        if due_s is None or abs(stamped_s - due_s) > tick:
            due_s = Fraction(round(stamped_s * rate), rate)
        heard_s = length_s if abs(stated_s - length_s) <= tick else stated_s  # the last may be heard in part
        packet.pts = packet.dts = round(due_s * rate)
        packet.time_base, packet.duration = Fraction(1, rate), round(heard_s * rate)
        due_s += length_s
        yield packet


def _stamped(packet: av.packet.Packet[Any], samples: int, clock: _Clock, rate: int) -> av.packet.Packet[Any]:
    clock.stamp(packet, samples, rate)
    packet.dts, packet.duration = packet.pts, samples
    return packet


def _in_seconds(samples: int, rate: int) -> Iterator[int]:
    """So many samples, at most a second's at a time."""
    for start in range(0, samples, rate):
        yield min(rate, samples - start)
