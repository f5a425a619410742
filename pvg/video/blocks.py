"""Whether a Matroska file has all its blocks: its elements follow each other without a gap (RFC 9559)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from pvg.video.ebml import CLUSTER, SEGMENT, element_at, next_outer

# a cluster's timestamp, or a checksum, a filler, its place or the size of the one before, which may stand before that
_FIRST_OF_CLUSTER = (b"\xe7", b"\xbf", b"\xec", b"\xa7", b"\xab")
_MOST_ELEMENTS = 2_000_000  # an hour of pictures and sound has some 400,000


@dataclass(frozen=True)
class Blocks:
    """How far a file's blocks go.

    end: where the last element ends, past the file's end when that is not whole. gap: the place in the middle at which
    an element ought to begin and none does, None where there is no such place.
    """

    end: int
    gap: int | None = None


def read_blocks(path: Path) -> Blocks:
    """Go through a Matroska file from block to block; what lies behind the first two million is not looked at."""
    with path.open("rb") as file:
        return _read(file, path.stat().st_size)


def _read(file: BinaryIO, size: int) -> Blocks:
    at = 0
    segment_end: int | None = None
    cluster_end: int | None = None
    for _ in range(_MOST_ELEMENTS):
        cluster_end = None if at == cluster_end else cluster_end
        if at >= size or at == segment_end:
            break
        found = element_at(file, at)
        if found is None or not _fits(found[0], found[2], cluster_end, size):
            if _goes_on(file, at, size):
                return Blocks(at, at)
            if found is not None:
                return Blocks(max(size + 1, found[2] or 0))
            file.seek(at)
            padded = cluster_end is None and not any(file.read(4096))
            return Blocks(at if padded else size + 1)
        identity, body, stop = found
        if identity == SEGMENT:
            segment_end = stop
        elif segment_end is not None and stop is not None and stop > segment_end:
            segment_end = None  # what was written on after its size was is there all the same
        if identity == CLUSTER:
            cluster_end = stop
        at = body if identity in (SEGMENT, CLUSTER) or stop is None else stop
    return Blocks(at)


def _goes_on(file: BinaryIO, at: int, size: int) -> bool:
    """Whether elements begin again behind a place: a whole one that another follows, or a cluster with its first part.

    In the bytes of a picture an identity may stand by chance.
    """
    while (at := next_outer(file, at + 1, size)) < size:
        found = element_at(file, at)
        if found is None:
            continue
        identity, body, stop = found
        if identity == CLUSTER:
            first = element_at(file, body)
            if first is not None and first[0] in _FIRST_OF_CLUSTER:
                return True
        elif stop is not None and (stop == size or (stop < size and element_at(file, stop) is not None)):
            return True
    return False


def _fits(identity: bytes, stop: int | None, within: int | None, size: int) -> bool:
    """Whether an element ends no later than the cluster it is in, and than the file, where it is not entered."""
    if stop is None:
        return True
    return (within is None or stop <= within) and (identity in (SEGMENT, CLUSTER) or stop <= size)
