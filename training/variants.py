"""Other pictures made of a labelled one before anything is told of it, for a network that is shown features of it.

`training.augmentation` changes what the network is shown, cell by cell, and another network's features of the picture
would not know. So some pictures are made anew in full: other hair, cloth and walls, other light.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np

from pvg._arrays import Bytes, Floats
from pvg.picture import as_picture
from training.augmentation import other_picture
from training.examples import Example, Labelled, Maker


def with_variants(make: Maker, count: int) -> Maker:
    """What `make` makes of a labelled picture, and of `count` others that are made of it."""

    def maker(face: Labelled) -> list[Example]:
        rng = np.random.default_rng(int(hashlib.sha256(face.person.encode()).hexdigest()[:8], 16))
        out = make(face)
        rgb = np.asarray(face.picture.rgb(), np.float32) / np.float32(255)
        labels = np.stack(face.masks, axis=-1).astype(np.float32)
        for _ in range(count):
            other = as_picture(_bytes(other_picture(rgb, labels, rng)))
            out += make(replace(face, picture=other, keys=[]))
        return out

    return maker


def _bytes(rgb: Floats) -> Bytes:
    return np.asarray(np.clip(rgb * 255 + 0.5, 0, 255), np.uint8)
