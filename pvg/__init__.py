"""Face colour transfer for portrait video: vectorise a clip once, then give it many looks.

    video = pvg.vectorize("clip.mp4")
    look = pvg.transfer(video, pvg.vectorize("portrait.jpg"), contrast=1.1)
    pvg.render(video, [look], ["out.mp4"])

The method is "PVG-Guided Face Color Transfer for Videos", IEEE Computer Graphics and Applications, 2021.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from pvg._version import __version__ as __version__
from pvg.errors import (
    AssetError,
    FaceTooSmallError,
    LimitError,
    MediaError,
    ModelError,
    NoFaceError,
    PvgError,
    SolverError,
    TooLargeError,
    TooLongError,
)

if TYPE_CHECKING:
    from pvg.asset import VectorVideo, open_asset
    from pvg.looks.exchange import exchange
    from pvg.looks.look import Look
    from pvg.looks.transfer import transfer
    from pvg.rendering import export, layer, render, render_frame, swap
    from pvg.vectorization import vectorize
    from pvg.video import MediaLimits, inspect

__all__ = [
    "AssetError",
    "FaceTooSmallError",
    "LimitError",
    "Look",
    "MediaError",
    "MediaLimits",
    "ModelError",
    "NoFaceError",
    "PvgError",
    "SolverError",
    "TooLargeError",
    "TooLongError",
    "VectorVideo",
    "exchange",
    "export",
    "inspect",
    "layer",
    "open_asset",
    "render",
    "render_frame",
    "swap",
    "transfer",
    "vectorize",
]

# what takes long to load is loaded when it is first asked for: the command's help needs none of it, a transfer half
_HOMES = {
    "Look": "pvg.looks",
    "MediaLimits": "pvg.video",
    "VectorVideo": "pvg.asset",
    "exchange": "pvg.looks",
    "export": "pvg.rendering",
    "inspect": "pvg.video",
    "layer": "pvg.rendering",
    "open_asset": "pvg.asset",
    "render": "pvg.rendering",
    "render_frame": "pvg.rendering",
    "swap": "pvg.rendering",
    "transfer": "pvg.looks",
    "vectorize": "pvg.vectorization",
}

if not TYPE_CHECKING:  # a type checker would take every name for known

    def __getattr__(name: str) -> object:
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(_HOMES[name]), name)
        globals()[name] = value  # asked once
        return value

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})
