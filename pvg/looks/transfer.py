"""Algorithm 1, transfer: a vectorised clip and a reference give a look, the clip's new boundary colours g'.

Only the colours of the key frames are moved, by sliced optimal mass transport (eq. 7, 8); no pixel is read. The
transport of a person is one map for the whole clip: it serves all their faces and key frames, so that a look does
not change at a cut and light that differs between shots stays. A key frame that is lit more or less brightly takes the
map relative to its exposure (`looks/exposure.py`), so that light that changes stays light.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from pvg._arrays import Doubles, Floats
from pvg.asset import FaceSummary, KeyFrame, VectorVideo, faces_by_index
from pvg.looks.color_map import SMALLEST_GROUP, ColorMap, TransportSteps, all_colors_map
from pvg.looks.exposure import Exposure, at_exposure, leading_key
from pvg.looks.light import light_ratio, relit
from pvg.looks.look import CONTRAST_RANGE, EXTENTS, PROTECTABLE, BodyMap, Contrast, Look
from pvg.looks.parts import MAKEUP, Makeup, PartChanges, strengths
from pvg.looks.tone import SkinMap

BETA = 0.2  # β of eq. (7) [paper]
ITERATIONS = 20  # N of eq. (7) [paper]
LIGHT = 0.25  # default strength of the light [by blind choice]


def reference_face_of(reference: VectorVideo, face: int | None = None) -> FaceSummary:
    """The face whose colours a reference gives: `face`, or its largest one.

    Raises `ValueError` when there is no such face.
    """
    if face is None:
        return max(reference.faces, key=lambda one: one.width_px)
    (index,) = faces_by_index(reference, (face,), what="reference")
    return reference.faces[index]


def _reference_key(reference: VectorVideo, face: int | None) -> KeyFrame:
    return leading_key([reference.records[reference_face_of(reference, face).index]])


def _check(strength: float, light: float, contrast: Contrast, match: str, protect: Sequence[str], extent: str) -> None:
    for name, share in (("strength", strength), ("light", light)):
        if not 0.0 <= share <= 1.0:
            raise ValueError(f"{name} must be in [0, 1], not {share}")
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
    reference_face: int | None = None,
    strength: float = 1.0,
    contrast: Contrast = "auto",
    match: str = "semantic",
    makeup: Makeup = MAKEUP,
    light: float = LIGHT,
    protect: Sequence[str] = PROTECTABLE,
    extent: str = "skin",
    faces: Literal["all"] | Sequence[int] = "all",
    beta: float = BETA,
    iterations: int = ITERATIONS,
    seed: int = 0,
) -> Look:
    """Give the faces of `video` the face colours of a face of `reference` (eq. 7, 8).

    reference_face: its index there, the largest when None;  strength: in [0, 1], 0 leaves the clip as it is;
    contrast: λ in [0.7, 1.5], 1 as in the paper, or "auto" for a λ that follows the brightness the transfer asks for;
    match: "semantic" moves skin to skin, "color" transports all boundary colours together as the paper does;
    makeup: in [0, 1] for all parts or by part, how far lips, lids, cheeks and brows take the reference's difference to
    its skin; "color" has none;  light: in [0, 1], how far light falls on the face from where it does on the reference;
    protect: features that keep their own colour;  extent: "skin", all skin of a person, or "face", which leaves chest,
    arms and hands as they are;  faces: "all", or the indices of those to change;
    beta, iterations: of eq. (7), the paper's 0.2 and 20;  seed: of the random rotations.
    Raises `ValueError` on a parameter out of range or an unknown face or part.
    """
    _check(strength, light, contrast, match, protect, extent)
    target = _reference_key(reference, reference_face)
    steps = TransportSteps(beta, iterations, seed)
    wanted = strengths(makeup)[:, None]
    changes = PartChanges.of(target) if match == "semantic" and len(target.skin) else None
    chosen = faces_by_index(video, faces)
    colors: dict[int, Floats] = {}
    fields: dict[int, Floats] = {}
    parts: dict[int, Floats] = {}
    body: dict[int, BodyMap] = {}
    share = np.float32(strength)
    for person in video.persons:
        if not set(person) & set(chosen):
            continue
        leading = leading_key([video.records[index] for index in person])
        plain, leading = leading, relit(leading, light_ratio(leading, target, light))
        skin = _skin_map(leading, target, steps) if match == "semantic" else None
        apply = all_colors_map(leading, target, steps) if skin is None else _at_curves(skin)
        # the paper's way moves every key frame by the same map
        exposures = Exposure.between(leading, apply) if video.settings["matching"] != "chain" else None
        # light falls on the face alone
        whole = None
        if extent == "skin":
            whole = skin if skin is not None and plain is leading else _body_map(plain, target, steps)
        for index in person:
            if index not in chosen:
                continue
            new, slopes, gained, exposed = [], [], [], []
            for key in video.records[index].key_frames:
                ratio = light_ratio(key, target, light)
                lit = relit(key, ratio)
                gain, kept = exposures.of(lit) if exposures is not None else (1.0, 1.0)
                exposed.append((gain, kept))
                lit = at_exposure(lit, 1.0 / gain)
                moved, slope = apply(lit)
                slope = slope * ratio[:, None] * np.float32(kept / gain)
                if skin is not None and changes is not None:
                    gained.append(share * wanted * np.float32(kept) * changes.on(skin, lit))
                new.append(key.colors + share * (_into_gamut(kept * moved).astype(np.float32) - key.colors))
                slopes.append(np.float32(1.0) + share * (slope - np.float32(1.0)))
            colors[index], fields[index] = np.stack(new).astype(np.float32), np.stack(slopes)
            if gained:
                parts[index] = np.stack(gained)
            if whole is not None:
                body[index] = BodyMap(whole, strength, np.array(exposed, np.float32))
    number = 1.0 if contrast == "auto" else 1.0 + strength * (contrast - 1.0)
    return Look(colors, fields if contrast == "auto" else number, tuple(protect), parts, body)


def _at_curves(skin: SkinMap) -> ColorMap:
    return lambda key: (skin(key.colors), skin.contrast(key.colors))


def _skin_map(key: KeyFrame, target: KeyFrame, steps: TransportSteps) -> SkinMap | None:
    """The smooth map of the transport of the open skin; None without enough of it on either side."""
    if min(len(key.skin), len(target.skin)) == 0:
        return None
    return SkinMap.between(key.skin, steps.transport(key.skin, target.skin))


def _body_map(key: KeyFrame, target: KeyFrame, steps: TransportSteps) -> SkinMap:
    """The same for the rest of a person's skin; curves stand in where there is too little open skin."""
    skin = _skin_map(key, target, steps)
    if skin is not None:
        return skin
    own, wanted = key.colors[key.visible], target.colors[target.visible]
    if min(len(own), len(wanted)) < SMALLEST_GROUP:
        return SkinMap.between(key.colors, key.colors.astype(np.float64))
    return SkinMap.between(own, steps.transport(own, wanted))


def _into_gamut(colors: Doubles) -> Doubles:
    """Colours (n, 3) darkened to at most 255 in their own hue: cut channel by channel they would turn white."""
    positive = np.maximum(colors, 0.0)
    return np.asarray(positive * np.minimum(1.0, 255.0 / np.maximum(positive.max(axis=1, keepdims=True), 1.0)))
