"""A file of packets: a clip's container, what it says of itself, and the tracks that go along with its pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from fractions import Fraction
from pathlib import Path
from typing import BinaryIO

import av
import av.container
import av.error
import av.video.stream

from pvg.errors import MediaError
from pvg.video.audio import SoundTrack
from pvg.video.carrying import CarriedTrack, attach
from pvg.video.containers import CONTAINER_FORMATS, has_edits
from pvg.video.encoding import CodedPacket
from pvg.video.even_rate import EvenTimes
from pvg.video.languages import language_in
from pvg.video.opening import reason
from pvg.video.pixel_aspect import say_pixel_aspect
from pvg.video.plan import Plan, needs_general_tags
from pvg.video.subtitles import SubtitleTrack

_CHAPTER_STEP = Fraction(1, 1_000_000)


class ClipMuxer:
    """Writes packets of pictures, in coding order, as a clip with all that its plan keeps.

    target: a path, or a binary stream. time_base: of the packets, in seconds a tick. add_stream: makes the stream of
    the pictures in the new file. even_rate: of pictures whose time stamps are rounded, see `MediaInfo`: MP4 and MOV get
    those of the rate itself.

    `open`, then `write` any number of packets, then `finish`; `abandon` instead closes what is there and removes the
    file. Raises MediaError for tracks that are damaged; libav's own errors pass through.
    """

    def __init__(
        self,
        target: Path | BinaryIO,
        plan: Plan,
        time_base: Fraction,
        add_stream: Callable[[av.container.OutputContainer], av.video.stream.VideoStream],
        even_rate: Fraction | None = None,
    ) -> None:
        self._path = target if isinstance(target, Path) else None
        self._target: BinaryIO | str = f"file:{target.absolute()}" if isinstance(target, Path) else target
        self._plan, self._time_base, self._add_stream = plan, time_base, add_stream
        self._output: av.container.OutputContainer | None = None
        self._tracks: list[CarriedTrack] = []
        self._held: CodedPacket | None = None
        self._first_dts: int | None = None
        self._even_rate = even_rate if has_edits(plan.container) else None
        self._times: EvenTimes | None = None

    def open(self) -> None:
        """Open the file and describe it. When that fails nothing of it is left."""
        plan, options = self._plan, {}
        if has_edits(plan.container):
            # Edit lists count in the movie's time scale: the clip's own keeps a late first frame exact
            scale = str(max(1000, self._written_base.denominator))
            flags = "+faststart+use_metadata_tags" if needs_general_tags(plan) else "+faststart"
            options = {"movflags": flags, "movie_timescale": scale}
        if plan.container in ("matroska", "webm"):
            options["fflags"] = "+bitexact"  # else files and tracks are told apart by random numbers
        output = self._output = av.open(self._target, "w", format=plan.container, options=options)
        try:
            self._stream = self._add_stream(output)
            self._stream.time_base = self._written_base
            self._describe(output)
            if plan.source is not None:
                for kind, wanted in ((SoundTrack, plan.sounds), (SubtitleTrack, plan.subtitles)):
                    for one in wanted:
                        self._tracks.append(kind(plan.source, output, plan.container, one))
                if plan.attachments:
                    attach(plan.source, output, plan.attachments)
            self._set_chapters(output)
        except BaseException:
            self.abandon()
            raise

    @property
    def _written_base(self) -> Fraction:
        """Seconds a tick of the pictures' time stamps in the new file."""
        if self._even_rate is None:
            return self._time_base
        return EvenTimes(self._even_rate, self._time_base).time_base

    def _describe(self, output: av.container.OutputContainer) -> None:
        """Tags and timecode."""
        plan = self._plan
        output.metadata.update(plan.metadata)
        own: dict[str, str] = {}
        if plan.picture is not None:
            own = dict(plan.picture.tags) if CONTAINER_FORMATS[plan.container].matroska_tags else {}
            language = language_in(plan.container, plan.picture.language)
            for key, text in (("language", language), ("title", plan.picture.title)):
                own |= {key: text} if text is not None else {}
        if plan.picture is None or "default" in plan.picture.dispositions:
            self._stream.disposition = av.stream.Disposition.default
        if plan.timecode is not None and plan.container == "matroska":
            output.metadata["timecode"] = plan.timecode
        elif plan.timecode is not None:
            own["timecode"] = plan.timecode
            own |= {} if plan.reel is None else {"reel_name": plan.reel}
        if own:
            self._stream.metadata.update(own)

    def _set_chapters(self, output: av.container.OutputContainer) -> None:
        """The chapters, moved as libav moves the packets where the container has no time before zero."""
        if not self._plan.chapters:
            return
        moved, iso = Fraction(0), has_edits(self._plan.container)
        if not iso:
            moved = max((track.lead_s() for track in self._tracks if isinstance(track, SoundTrack)), default=moved)
        output.set_chapters(
            [
                {
                    "id": k,
                    "start": round((chapter.start_s + moved) / _CHAPTER_STEP),
                    "end": round((chapter.end_s + moved) / _CHAPTER_STEP),
                    "time_base": _CHAPTER_STEP,
                    # MP4 has them as text in a track: one without any would be none
                    "metadata": {} if chapter.title is None and not iso else {"title": chapter.title or ""},
                }
                for k, chapter in enumerate(self._plan.chapters)
            ]
        )

    def write(self, packets: Iterable[CodedPacket]) -> None:
        """Write the next packets, and of the other tracks what is due before them."""
        for packet in packets:
            with self._damage_as_media_error():
                self._flush_held()
            self._held = self._at_even_rate(packet)

    @contextmanager
    def _damage_as_media_error(self) -> Iterator[None]:
        """Raise a `MediaError` about the other tracks for data that the muxer calls invalid.

        It cannot be the pictures', which an encoder has just made.
        """
        try:
            yield
        except av.error.InvalidDataError as error:
            if not self._tracks:
                raise
            what = f"{self._tracks[0].name}: its sound or subtitles are damaged ({reason(error)})"
            raise MediaError(f"{what}; render without sound or upload it again") from error

    def _at_even_rate(self, packet: CodedPacket) -> CodedPacket:
        """The packet with time stamps of the even rate, if there is one."""
        if self._even_rate is None or packet.pts is None or packet.dts is None:
            return packet
        if self._times is None:
            self._times = EvenTimes(self._even_rate, self._time_base, packet.pts)
        pts, dts, end = (self._times.ticks(at) for at in (packet.pts, packet.dts, packet.pts + (packet.duration or 0)))
        packet.pts, packet.dts, packet.duration, packet.time_base = pts, dts, end - pts, self._times.time_base
        return packet

    def _flush_held(self) -> None:
        packet, self._held = self._held, None
        if packet is None:
            return
        if packet.dts is not None:
            for track in self._tracks:
                track.feed(packet.dts * packet.time_base)
        if self._first_dts is None:
            self._first_dts = packet.dts
        assert self._output is not None  # noqa: S101 - `open` comes first
        packet.stream = self._stream
        self._output.mux_one(packet)

    def finish(self, first_pts: int, end_pts: int) -> None:
        """Write what is left, and the index. first_pts, end_pts: where the pictures start and end, in ticks."""
        last = self._held
        if self._times is not None:
            first_pts, end_pts = self._times.ticks(first_pts), self._times.ticks(end_pts)
        if (
            has_edits(self._plan.container)
            and last is not None
            and last.dts is not None
            and last.time_base == self._written_base
        ):
            # MP4 sums durations in coding order, so the last packet coded ends the clip, whichever it shows
            first_dts = last.dts if self._first_dts is None else self._first_dts
            last.duration = max(1, end_pts - first_pts - (last.dts - first_dts))
        with self._damage_as_media_error():
            self._flush_held()
            for track in self._tracks:
                track.feed(None)
                track.close()
            if self._output is not None:
                self._output.close()
        if self._path is not None and self._plan.aspect != 1:
            say_pixel_aspect(self._path, self._plan.aspect)

    def abandon(self) -> None:
        """Throw away what was written."""
        for track in self._tracks:
            track.close()
        with suppress(av.error.FFmpegError, OSError, ValueError):  # what was written is thrown away anyway
            if self._output is not None:
                self._output.close()
        if self._path is not None:
            self._path.unlink(missing_ok=True)
