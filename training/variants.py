"""Other pictures made of a labelled one before anything is told of it, for a network that is shown features of it.

`training.augmentation` changes what the network is shown, cell by cell, and another network's features of the picture
would not know. So some pictures are made anew in full: other hair, cloth and walls, other light.
"""

from __future__ import annotations

import hashlib

import numpy as np

from pvg._arrays import Bools, Bytes, Floats
from pvg.face import Landmarks
from pvg.picture import Picture, as_picture
from training.augmentation import other_picture
from training.examples import Example, Maker


def with_variants(make: Maker, count: int) -> Maker:
    """What `make` makes of a labelled picture, and of `count` others that are made of it."""

    def maker(
        person: str,
        picture: Picture,
        landmarks: Landmarks,
        masks: list[Bools],
        keys: list[tuple[Picture, Landmarks]],
    ) -> list[Example]:
        rng = np.random.default_rng(int(hashlib.sha256(person.encode()).hexdigest()[:8], 16))
        out = make(person, picture, landmarks, masks, keys)
        rgb = np.asarray(picture.rgb(), np.float32) / np.float32(255)
        labels = np.stack(masks, axis=-1).astype(np.float32)
        for _ in range(count):
            out += make(person, as_picture(_bytes(other_picture(rgb, labels, rng))), landmarks, masks, [])
        return out

    return maker


def _bytes(rgb: Floats) -> Bytes:
    return np.asarray(np.clip(rgb * 255 + 0.5, 0, 255), np.uint8)
