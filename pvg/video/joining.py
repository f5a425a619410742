"""Parts of a clip into one: their packets are copied, decode time stamps mended where two parts meet."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import av.error

from pvg.errors import PartError
from pvg.video.containers import CONTAINERS, PIPED
from pvg.video.encoders import ENCODERS
from pvg.video.encoding import CodedPacket, PictureEncoder, decoding_times
from pvg.video.info import MediaInfo
from pvg.video.muxing import ClipMuxer
from pvg.video.parts import ClipOfParts, PartHead, PartReader, head_of
from pvg.video.plan import Plan


def can_join(container: str, codec: str = "auto") -> bool:
    """Whether clips of this container and codec can be made of parts.

    All that are written to files can. Pipes are written as they are drawn, and pictures are one frame.
    """
    return CONTAINERS.get(container, PIPED[0]) not in PIPED and codec in ("auto", *ENCODERS) and codec != "raw"


def join(parts: Sequence[Path], path: Path, info: MediaInfo, plan: Plan, clip: ClipOfParts) -> None:
    """Write the clip that these parts are, in this order, with what its plan keeps.

    info, plan, clip: those the parts were drawn with. When it fails no file is left. Raises PartError for a part that
    is missing, damaged or of another clip, place or manner, and where frames are not as many as the clip's.
    """
    encoder = PictureEncoder(info, info.format, plan, crf=clip.crf, preset=clip.preset, part=True, name=path.name)
    muxer = ClipMuxer(path, plan, encoder.time_base, encoder.stream_of, info.even_rate)
    muxer.open()
    try:
        wanted = head_of(clip, encoder, 0, clip.frame_count)
        stamps, end, delay = _timed(parts, wanted)
        # a part's encoder, which does not know what was shown before, gives its first packets others
        decoded = decoding_times(stamps, delay)
        for part in parts:
            muxer.write(_packets(part, decoded))
        muxer.finish(stamps[0], end)
    except av.error.FFmpegError as error:
        muxer.abandon()
        raise encoder.failure(error) from error
    except BaseException:
        muxer.abandon()
        raise


def _timed(parts: Sequence[Path], wanted: PartHead) -> tuple[list[int], int, int]:
    """The time stamps of all frames, the end of the last and the delay, once all parts are known to fit together."""
    stamps, end, delay = list[int](), 0, 0
    for part in parts:
        with PartReader(part) as reader:
            head, start = reader.head, len(stamps)
            if head.start != start:
                raise PartError(f"{part.name}: the part has frames [{head.start}, {head.stop}), not those from {start}")
            if replace(head, start=0, stop=wanted.stop) != wanted:
                raise PartError(f"{part.name}: the part is of another clip, or drawn in another manner; draw it again")
            if stamps and reader.stamps[0] <= stamps[-1]:
                raise PartError(f"{part.name}: time stamps do not rise from the part before; draw the clip whole")
            stamps += reader.stamps
            end, delay = reader.end, max(delay, reader.delay)
    if len(stamps) != wanted.frame_count or not stamps:
        raise PartError(f"the parts have {len(stamps)} frames of {wanted.frame_count}: draw what is missing")
    return stamps, end, delay


def _packets(part: Path, decoded: Iterator[int]) -> Iterator[CodedPacket]:
    """The packets of a part, ready for the clip."""
    with PartReader(part) as reader:
        first = True
        for packet in reader.packets():
            dts = next(decoded, None)
            if first and not packet.is_keyframe:
                raise PartError(f"{part.name}: the part does not begin with a key picture; draw it again")
            if packet.pts is None or dts is None or packet.pts < dts:
                raise PartError(f"{part.name}: the part is damaged (its packets are in disorder); draw it again")
            packet.dts, first = dts, False
            yield packet
