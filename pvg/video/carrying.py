"""Tracks that go along with the pictures: each from its own reading of the source, fed as far as these have come."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeAlias

import av
import av.container
import av.error
import av.packet
import av.stream

from pvg.errors import MediaError
from pvg.video.containers import CONTAINER_FORMATS
from pvg.video.languages import language_in
from pvg.video.opening import open_container, reason
from pvg.video.plan import Carried
from pvg.video.streams import Track

StampedPacket: TypeAlias = "tuple[Fraction, av.packet.Packet[Any]]"
"""When a packet is due, in seconds, and itself."""


class CarriedTrack(ABC):
    """One track of `source`, fed into `output`. Only one packet is held. Raises MediaError."""

    what = ""
    instead = ""

    def __init__(self, source: Path, output: av.container.OutputContainer, container: str, carried: Carried) -> None:
        self._stack = ExitStack()
        self._output, self._container = output, container
        self.name = source.name
        self.carried = carried
        try:
            opened = self._stack.enter_context(open_container(source, 2**30))
            self._source: Any = opened.streams[carried.track.index]
            for other in opened.streams:
                if other.index != self._source.index:
                    other.discard = av.stream.Discard.all
            self._target: Any = self._add_stream(output, carried)
            self._describe()
        except BaseException:
            self._stack.close()
            raise
        self._packets = self._produce(opened)
        self._pending: StampedPacket | None = None
        self._ended = False

    @abstractmethod
    def _add_stream(self, output: av.container.OutputContainer, carried: Carried) -> Any:
        """The stream of the new clip."""

    @abstractmethod
    def _produce(self, opened: av.container.InputContainer) -> Iterator[StampedPacket]:
        """The new clip's packets, in the order of their due times."""

    def _describe(self) -> None:
        track, container = self.carried.track, self._container
        tags: dict[str, str] = {}
        if CONTAINER_FORMATS[container].matroska_tags:
            tags |= dict(track.tags)
        elif track.handler is not None:
            tags["handler_name"] = track.handler
        language = language_in(container, track.language)
        tags |= {key: text for key, text in (("language", language), ("title", track.title)) if text is not None}
        if tags:
            self._target.metadata.update(tags)
        if track.dispositions:
            self._target.disposition = sum(av.stream.Disposition[one] for one in track.dispositions)

    def begins_s(self) -> Fraction:
        """When its first packet begins; 0 where there is none. Raises MediaError."""
        if self._pending is None and not self._ended:
            self._pending = self._take()
        packet = None if self._pending is None else self._pending[1]
        return Fraction(0) if packet is None or packet.pts is None else packet.pts * packet.time_base

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
            packet = self._pending[1]
            packet.stream = self._target
            self._output.mux_one(packet)
            self._pending = None

    def _take(self) -> StampedPacket | None:
        try:
            return next(self._packets, None)
        except (av.error.FFmpegError, ValueError) as error:
            raise MediaError(f"{self.name}: the {self.what} is damaged ({reason(error)}); {self.instead}") from error

    def close(self) -> None:
        """Let go of the source."""
        self._packets = iter(())
        self._stack.close()


def attach(source: Path, output: av.container.OutputContainer, tracks: Sequence[Track]) -> None:
    """Put the source's attached files into a Matroska clip."""
    with open_container(source, 2**30) as opened:
        for track in tracks:
            held: Any = opened.streams[track.index]
            added = output.add_attachment(track.name or "", held.mimetype or "application/octet-stream", held.data)
            if track.title is not None:
                added.metadata["title"] = track.title
