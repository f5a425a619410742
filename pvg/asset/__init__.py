"""A vectorised clip on disk: one zip file of a JSON manifest and plain arrays, read by frame range.

The manifest lists the sha256 of every entry and the archive's comment holds the manifest's own, so an altered byte
is refused when it is read and a truncated file when it is opened. Arrays are .npy and loaded without pickle: opening
an asset never executes anything. Positions are kept as fixed-point steps from frame to frame, deflated, and mattes as
bytes, packed by bzip2, both in chunks of `CHUNK_FRAMES`. The source clip stays where the asset notes it, relative to
itself: it is the store of the Poisson regions, since f_i is the Laplacian of the clip itself.
"""

from __future__ import annotations

from pvg.asset.arrays import CHUNK_FRAMES
from pvg.asset.reading import VectorVideo, check_vectorized, faces_by_index, open_asset
from pvg.asset.records import FaceInFrame, FaceRecord, FaceSummary, KeyFrame, MediaSummary
from pvg.asset.source import source_note
from pvg.asset.writing import AssetWriter

__all__ = [
    "CHUNK_FRAMES",
    "AssetWriter",
    "FaceInFrame",
    "FaceRecord",
    "FaceSummary",
    "KeyFrame",
    "MediaSummary",
    "VectorVideo",
    "check_vectorized",
    "faces_by_index",
    "open_asset",
    "source_note",
]
