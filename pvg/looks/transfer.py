"""Algorithm 1, transfer: a vectorised clip and a reference give a look, the clip's new boundary colours g'.

Only the colours of the key frames are moved, by sliced optimal mass transport (eq. 7, 8); no pixel is read. The
transport of a person is one map for the whole clip: it serves all their faces and key frames, so that a look does
not change at a cut and light that differs between shots stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from pvg._arrays import Doubles, Floats
from pvg.asset import KeyFrame, VectorVideo, faces_by_index
from pvg.looks.color_map import SMALLEST_GROUP, TransportSteps, all_colors_map
from pvg.looks.look import CONTRAST_RANGE, EXTENTS, PROTECTABLE, BodyMap, Contrast, Look
from pvg.looks.parts import parts_map
from pvg.looks.tone import SkinMap

BETA = 0.2  # β of eq. (7) [paper]
ITERATIONS = 20  # N of eq. (7) [paper]


def _reference_key(reference: VectorVideo) -> KeyFrame:
    """The key frame of the reference's largest face."""
    largest = max(reference.records, key=lambda record: record.summary.width_px)
    return largest.key_frames[0]


def _check(strength: float, contrast: Contrast, match: str, protect: Sequence[str], extent: str) -> None:
    if not 0.0 <= strength <= 1.0:
        raise ValueError(f"strength must be in [0, 1], not {strength}")
    if contrast != "auto" and not (
        isinstance(contrast, (int, float)) and CONTRAST_RANGE[0] <= contrast <= CONTRAST_RANGE[1]
    ):
        raise ValueError(f'contrast must be "auto" or in [0.7, 1.5], not {contrast!r}')
    if match not in ("color", "semantic"):
        raise ValueError(f'match must be "color" or "semantic", not {match!r}')
    if extent not in EXTENTS:
        raise ValueError(f'extent must be "skin" or "face", not {extent!r}')
    if unknown := [part for part in protect if part not in PROTECTABLE]:
        raise ValueError(f"cannot protect {unknown[0]!r}; known are {', '.join(PROTECTABLE)}")


def transfer(
    video: VectorVideo,
    reference: VectorVideo,
    *,
    strength: float = 1.0,
    contrast: Contrast = "auto",
    match: str = "semantic",
    protect: Sequence[str] = PROTECTABLE,
    extent: str = "skin",
    faces: Literal["all"] | Sequence[int] = "all",
    beta: float = BETA,
    iterations: int = ITERATIONS,
    seed: int = 0,
) -> Look:
    """Give the faces of `video` the face colours of `reference`'s largest face (eq. 7, 8).

    strength: in [0, 1], 0 leaves the clip as it is;  contrast: λ in [0.7, 1.5], 1 as in the paper, or "auto" for
    a λ that follows the brightness the transfer asks for;  match: "semantic" moves skin to skin and lips to lips,
    "color" transports all boundary colours together as the paper does;  protect: features that keep their own colour;
    extent: "skin", all skin of a person, or "face", which leaves chest, arms and hands as they are;
    beta, iterations: of eq. (7), the paper's 0.2 and 20;  seed: of the random rotations.
    Raises `ValueError` on a parameter out of range or an unknown face.
    """
    _check(strength, contrast, match, protect, extent)
    target = _reference_key(reference)
    steps = TransportSteps(beta, iterations, seed)
    make_map = parts_map if match == "semantic" else all_colors_map
    chosen = faces_by_index(video, faces)
    colors: dict[int, Floats] = {}
    fields: dict[int, Floats] = {}
    body: dict[int, BodyMap] = {}
    share = np.float32(strength)
    for person in video.persons:
        if not set(person) & set(chosen):
            continue
        leading = _leading_key(video, person)
        apply = make_map(leading, target, steps)
        whole = BodyMap(_skin_map(leading, target, steps), strength) if extent == "skin" else None
        for index in person:
            if index not in chosen:
                continue
            if whole is not None:
                body[index] = whole
            new, slopes = [], []
            for key in video.records[index].key_frames:
                moved, slope = apply(key)
                new.append(key.colors + share * (_into_gamut(moved).astype(np.float32) - key.colors))
                slopes.append(np.float32(1.0) + share * (slope - np.float32(1.0)))
            colors[index], fields[index] = np.stack(new).astype(np.float32), np.stack(slopes)
    number = 1.0 if contrast == "auto" else 1.0 + strength * (contrast - 1.0)
    return Look(colors, fields if contrast == "auto" else number, tuple(protect), body)


def _skin_map(key: KeyFrame, target: KeyFrame, steps: TransportSteps) -> SkinMap:
    """The map of a person's skin to the reference's; curves stand in where there is too little open skin."""
    own, wanted = key.skin, target.skin
    if min(len(own), len(wanted)) == 0:
        own, wanted = key.colors[key.visible], target.colors[target.visible]
        if min(len(own), len(wanted)) < SMALLEST_GROUP:
            return SkinMap.between(key.colors, key.colors.astype(np.float64))
    return SkinMap.between(own, steps.transport(own, wanted))


def _into_gamut(colors: Doubles) -> Doubles:
    """Colours (n, 3) darkened to at most 255 in their own hue: cut channel by channel they would turn white."""
    positive = np.maximum(colors, 0.0)
    return np.asarray(positive * np.minimum(1.0, 255.0 / np.maximum(positive.max(axis=1, keepdims=True), 1.0)))


def _leading_key(video: VectorVideo, person: Sequence[int]) -> KeyFrame:
    """The key frame that a person's map is made from: of the face seen longest, if its skin could be sampled."""
    keys = [video.records[index].key_frames[0] for index in person]
    return next((key for key in keys if len(key.skin)), keys[0])
