"""Sound from the source clip into a new one: packets copied, or transcoded where the container cannot hold them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from typing import TypeAlias

import av
import av.audio.stream
import av.container
import av.error
import av.packet
import av.stream

from pvg.errors import MediaError
from pvg.video.opening import open_container, reason

_CARRIES = {
    "mp4": {"aac", "mp3", "mp3float", "mp2", "ac3", "eac3", "alac", "flac", "opus"},
    "mov": {"aac", "mp3", "mp3float", "ac3", "eac3", "alac", "pcm_s16le", "pcm_s16be", "pcm_s24le", "pcm_s24be"},
    "webm": {"opus", "vorbis"},
    "matroska": {
        *("aac", "mp3", "mp3float", "mp2", "ac3", "eac3", "alac", "flac", "opus", "vorbis", "dca", "truehd"),
        *("pcm_s16le", "pcm_s24le", "pcm_s32le", "pcm_f32le", "pcm_u8"),
    },
}
"""Sound codecs (names of libav decoders) that a muxer takes and common players then play."""

_Packet: TypeAlias = "av.packet.Packet[av.audio.stream.AudioStream]"


class AudioTrack:
    """The first sound track of `source`, fed into `output` as far as the pictures have come.

    Time stamps keep the source's origin, so sound and picture stay in step. Only one packet is held.
    """

    def __init__(self, source: Path, output: av.container.OutputContainer, container: str) -> None:
        self._stack = ExitStack()
        self._output = output
        self.name = source.name
        try:
            opened = self._stack.enter_context(open_container(source, 2**30))
            self._stream = opened.streams.audio[0]
            for other in opened.streams:
                if other.index != self._stream.index:
                    other.discard = av.stream.Discard.all
            self.codec = self._stream.codec_context.name if self._stream.codec_context is not None else "unknown"
            self.copies = self.codec.removeprefix("lib") in _CARRIES[container]
            self._target = self._add_stream("libopus" if container == "webm" else "aac")
        except BaseException:
            self._stack.close()
            raise
        self._packets = self._produce(opened)
        self._pending: tuple[Fraction, _Packet] | None = None
        self._ended = False

    def _add_stream(self, fallback: str) -> av.audio.stream.AudioStream:
        if self.copies:
            return self._output.add_stream_from_template(self._stream)
        if self.codec == "unknown":
            raise MediaError(f"{self.name} has sound of a codec that is not known here; render without sound")
        rate = 48000 if fallback == "libopus" else self._stream.codec_context.sample_rate
        stream: av.audio.stream.AudioStream = self._output.add_stream(fallback, rate=rate)  # type: ignore[assignment]
        stream.codec_context.layout = self._stream.codec_context.layout.name
        stream.codec_context.bit_rate = 64_000 * max(1, self._stream.codec_context.layout.nb_channels)
        return stream

    def feed(self, until_s: Fraction | None) -> None:
        """Write the packets that start at or before until_s; None: all that are left. Raises MediaError."""
        while not self._ended:
            if self._pending is None:
                self._pending = self._take()
            if self._pending is None:
                self._ended = True
                return
            if until_s is not None and self._pending[0] > until_s:
                return
            self._output.mux_one(self._pending[1])
            self._pending = None

    def _take(self) -> tuple[Fraction, _Packet] | None:
        try:
            packet = next(self._packets, None)
        except (av.error.FFmpegError, ValueError) as error:
            raise MediaError(
                f"{self.name}: the sound is damaged ({reason(error)}); render without sound or upload it again"
            ) from error
        if packet is None:
            return None
        stamp = packet.dts if packet.dts is not None else packet.pts or 0
        packet.stream = self._target
        return stamp * packet.time_base, packet

    def _produce(self, opened: av.container.InputContainer) -> Iterator[_Packet]:
        for packet in opened.demux(self._stream):
            if self.copies:
                if packet.size:
                    yield packet
                continue
            for frame in packet.decode():
                yield from self._target.encode(frame)
        if not self.copies:
            yield from self._target.encode(None)

    def close(self) -> None:
        """Let go of the source."""
        self._packets = iter(())
        self._stack.close()
