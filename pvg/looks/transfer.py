"""Algorithm 1, transfer: a vectorised clip and a reference give a look, the clip's new boundary colours g'.

Only the colours of the key frames are moved, by sliced optimal mass transport (eq. 7, 8); no pixel is read. The
transport of a person is one map for the whole clip: it serves all their faces and key frames, so that a look does
not change at a cut and light that differs between shots stays. A key frame that is lit more or less brightly takes the
map relative to its exposure (`looks/exposure.py`), so that light that changes stays light.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from numbers import Real
from typing import Literal

import numpy as np

from pvg._arrays import Doubles, Floats
from pvg._checks import check_word, real_number, whole_number
from pvg.asset import FaceSummary, KeyFrame, VectorVideo, faces_by_index
from pvg.curves import GROUPS, table_labels
from pvg.face import PARTS
from pvg.looks.apart import parts_apart
from pvg.looks.color_map import SMALLEST_GROUP, ColorMap, TransportSteps, all_colors_map
from pvg.looks.complexion import complexion
from pvg.looks.depth import depth_of_features
from pvg.looks.exposure import Exposure, at_exposure, leading_key, on_skin
from pvg.looks.key_light import out_of_deep_shade
from pvg.looks.light import light_ratio, relit
from pvg.looks.look import CONTRAST_RANGE, EXTENTS, PROTECTABLE, BodyMap, Contrast, FaceContrast, Look
from pvg.looks.parts import MAKEUP, Makeup, PartChanges, strengths
from pvg.looks.scene import SCENE
from pvg.looks.tone import CRISP, SkinMap

BETA = 0.2  # β of eq. (7) [paper]
ITERATIONS = 20  # N of eq. (7) [paper]
LIGHT = 0.0  # default strength of the light [by blind choice]


def reference_face_of(reference: VectorVideo, face: int | None = None) -> FaceSummary:
    """The face whose colours a reference gives: `face`, or its largest one.

    Raises `ValueError` when there is no such face.
    """
    if face is None:
        return max(reference.faces, key=lambda one: one.width_px)
    face = whole_number("reference_face", face, low=None)
    (index,) = faces_by_index(reference, (face,), what="reference")
    return reference.faces[index]


def _reference_key(reference: VectorVideo, face: int | None) -> KeyFrame:
    return _lit(leading_key([reference.records[reference_face_of(reference, face).index]]))


def _lit(key: KeyFrame) -> KeyFrame:
    """A key frame whose open skin is that out of deep shade."""
    return replace(key, skin=out_of_deep_shade(key.skin))


def _check(contrast: Contrast, match: str, protect: Sequence[str], extent: str) -> Contrast:
    """The contrast. Raises `ValueError` for words that are none of these and a contrast out of range."""
    check_word("match", match, ("color", "semantic"))
    check_word("extent", extent, EXTENTS)
    if isinstance(protect, str) or not isinstance(protect, Collection):
        raise ValueError(f"protect must be a sequence of {', '.join(PROTECTABLE)}, not {protect!r}")
    if unknown := [part for part in protect if part not in PROTECTABLE]:
        raise ValueError(f"cannot protect {unknown[0]!r}; known are {', '.join(PROTECTABLE)}")
    if isinstance(contrast, str) and contrast == "auto":
        return contrast
    low, high = CONTRAST_RANGE
    if isinstance(contrast, bool) or not isinstance(contrast, Real) or not low <= contrast <= high:
        raise ValueError(f'contrast must be "auto" or in [{low}, {high}], not {contrast!r}')
    return float(contrast)


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
    scene: float = SCENE,
    protect: Sequence[str] = PROTECTABLE,
    extent: str = "skin",
    faces: Literal["all"] | Sequence[int] = "all",
    beta: float = BETA,
    iterations: int = ITERATIONS,
    seed: int = 0,
) -> Look:
    """Give the faces of `video` the face colours of a face of `reference` (eq. 7, 8).

    reference_face: its index there, the largest when None;  strength: in [0, 1], 0 leaves the clip as it is;
    contrast: λ in [0.7, 1.5], 1 as in the paper, or "auto": the look's own map of colour on every pixel in place of λ;
    where there is no such map, with "color" or too little open skin on either side, that is the paper's 1;
    match: "semantic" moves skin to skin, "color" transports all boundary colours together as the paper does;
    makeup: in [0, 1] for all parts or by part, how far lips, lids, cheeks and brows take the reference's difference to
    its skin, and parts left out of a mapping the default, 0.75; "color" has none;
    light: in [0, 1], how far light falls on the face from where it does on the reference;
    scene: in [0, 1], how far brightness and hue that lie far from the clip's give way to its scene, and highlights end
    below white: 0 takes the reference's own; "color" takes them in any case;
    protect: features that go their own way, of "eyes" and "teeth";  extent: "skin", all skin of a person, or "face",
    which leaves chest, arms and hands as they are;  faces: "all", or the indices of those to change;
    beta, iterations: of eq. (7), above 0 up to 1 and from 0 on, the paper's 0.2 and 20;  seed: of the random rotations.
    Raises `ValueError` on a parameter out of range or an unknown face or part.
    """
    contrast = _check(contrast, match, protect, extent)
    strength, light, scene = (
        real_number(name, share, 0.0, 1.0)
        for name, share in (("strength", strength), ("light", light), ("scene", scene))
    )
    target = _reference_key(reference, reference_face)
    steps = TransportSteps(
        beta=_beta(beta), iterations=whole_number("iterations", iterations), seed=whole_number("seed", seed)
    )
    wanted = strengths(makeup)
    changes = PartChanges.of(target) if match == "semantic" and len(target.skin) else None
    chosen = faces_by_index(video, faces)
    colors: dict[int, Floats] = {}
    contrasts: dict[int, FaceContrast] = {}
    parts: dict[int, Floats] = {}
    maps: dict[int, BodyMap] = {}
    share = np.float32(strength)
    for person in video.persons:
        if not set(person) & set(chosen):
            continue
        leading = _lit(leading_key([video.records[index] for index in person]))
        plain, leading = leading, relit(leading, light_ratio(leading, target, light))
        skin = _skin_map(leading, target, steps, scene, contrast) if match == "semantic" else None
        apply = all_colors_map(leading, target, steps) if skin is None else _at_curves(skin)
        exposures = None
        if video.settings["matching"] != "chain":  # the paper's way moves every key frame by the same map
            new_skin = apply(leading)[on_skin(leading)] if skin is None else skin(leading.skin)
            exposures = Exposure.between(leading, new_skin)
        # light falls on the face alone
        whole = skin if skin is not None and plain is leading else _body_map(plain, target, steps, scene, contrast)
        for index in person:
            if index not in chosen:
                continue
            new, gained, exposed = [], [], []
            for key in map(_lit, video.records[index].key_frames):
                lit = relit(key, light_ratio(key, target, light))
                gain, kept = exposures.of(lit) if exposures is not None else (1.0, 1.0)
                exposed.append((gain, kept))
                lit = at_exposure(lit, 1.0 / gain)
                moved = apply(lit)
                lacks = np.zeros((len(PARTS), 3), np.float32)
                if skin is not None and contrast != "auto":  # F, where it draws pixels, takes parts along
                    moved, lacks = parts_apart(lit, skin, moved)
                if skin is not None and changes is not None:
                    gained.append(share * np.float32(kept) * (lacks + changes.on(skin, lit, wanted)))
                new.append(key.colors + share * (_into_gamut(kept * moved).astype(np.float32) - key.colors))
            colors[index] = np.stack(new).astype(np.float32)
            contrasts[index] = 1.0 if skin is None else "map"
            if gained:
                parts[index] = np.stack(gained)
            maps[index] = BodyMap(whole, strength, np.array(exposed, np.float32))
    factor = 1.0 if contrast == "auto" else 1.0 + strength * (contrast - 1.0)
    body = frozenset(maps if extent == "skin" else ())
    return Look(
        colors, contrasts if contrast == "auto" else factor, tuple(protect), parts, maps, body, video.source_sha256
    )


def _beta(given: float) -> float:
    beta = real_number("beta", given, 0.0, 1.0)
    if beta == 0.0:
        raise ValueError("beta must be above 0: no step of eq. (7) would move a colour")
    return beta


def _at_curves(skin: SkinMap) -> ColorMap:
    """F at the curves: on skin with its k for patches, which H(g' − F(g)) then evens."""
    of_skin = (table_labels().group == GROUPS.index("skin"))[:, None]
    return lambda key: np.where(of_skin, skin(key.colors, skin.broad), skin(key.colors))


def _skin_map(
    key: KeyFrame, target: KeyFrame, steps: TransportSteps, scene: float, contrast: Contrast
) -> SkinMap | None:
    """The smooth map of the transport of the open skin; None without enough of it on either side.

    A number for λ is the contrast of all that lies between the curves: neither features nor shade get deeper then.
    """
    if min(len(key.skin), len(target.skin)) == 0:
        return None
    moved = steps.transport(key.skin, complexion(target.skin, key.skin, scene))
    if contrast != "auto":
        return SkinMap.between(key.skin, moved, bounded=scene)
    return SkinMap.between(key.skin, moved, depth_of_features(key, target), CRISP, bounded=scene)


def _body_map(key: KeyFrame, target: KeyFrame, steps: TransportSteps, scene: float, contrast: Contrast) -> SkinMap:
    """The same for the rest of a person's skin; curves stand in where there is too little open skin."""
    skin = _skin_map(key, target, steps, scene, contrast)
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
