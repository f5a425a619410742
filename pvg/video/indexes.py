"""How much a demuxer would hold of a clip's headers, counted in the file before one opens it.

Demuxers make an entry in memory for every sample that an index names, and a few bytes can name millions: an MP4 of
3 kB made libav take 4.7 GB. Each kind of file has its own reader: `iso_index`, `matroska_headers`, `avi_index`.
"""

from __future__ import annotations

from pathlib import Path

from pvg.errors import MediaError
from pvg.video.avi_index import count_frames
from pvg.video.iso_index import count_samples
from pvg.video.matroska_headers import check_headers
from pvg.video.sniffing import Kind

MOST_ENTRIES = 2_000_000
"""Samples that the indexes of all tracks together may name; two hours of pictures and sound have 800,000."""


def check_index(path: Path, kind: Kind) -> None:
    """Refuse a clip whose indexes name more than MOST_ENTRIES samples, or whose headers are as long as none needs.

    Pictures pass. Raises MediaError.
    """
    entries = index_entries(path, kind)
    if entries > MOST_ENTRIES:
        raise MediaError(f"{path.name} has an index of {entries} samples; at most {MOST_ENTRIES} are accepted")


def index_entries(path: Path, kind: Kind) -> int:
    """Samples that the indexes name: of an MP4 what libav would make entries of, of an AVI at least that, of other
    kinds 0. Raises MediaError for headers as long as none needs."""
    if kind not in ("mp4", "matroska", "avi"):
        return 0
    with path.open("rb") as file:
        name, size = path.name, path.stat().st_size
        if kind == "mp4":
            return count_samples(name, file, size)
        if kind == "avi":
            return count_frames(name, file, size)
        check_headers(name, file, size)
        return 0
