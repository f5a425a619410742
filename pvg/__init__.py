"""Face colour transfer for portrait video: vectorise a clip once, then give it many looks.

    video = pvg.vectorize("clip.mp4")
    look = pvg.transfer(video, pvg.vectorize("portrait.jpg"), contrast=1.1)
    pvg.render(video, [look], ["out.mp4"])

The method is "PVG-Guided Face Color Transfer for Videos", IEEE Computer Graphics and Applications, 2021.
"""

from __future__ import annotations

from pvg.asset import VectorVideo, open_asset
from pvg.errors import (
    AssetError,
    FaceTooSmallError,
    MediaError,
    ModelError,
    NoFaceError,
    PvgError,
    SolverError,
)
from pvg.looks import Look, transfer
from pvg.rendering import layer, render, render_frame, swap
from pvg.vectorization import vectorize
from pvg.video import MediaLimits

__all__ = [
    "AssetError",
    "FaceTooSmallError",
    "Look",
    "MediaError",
    "MediaLimits",
    "ModelError",
    "NoFaceError",
    "PvgError",
    "SolverError",
    "VectorVideo",
    "layer",
    "open_asset",
    "render",
    "render_frame",
    "swap",
    "transfer",
    "vectorize",
]

__version__ = "0.1.0"
