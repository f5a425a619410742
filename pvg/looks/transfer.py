"""Algorithm 1, transfer: a vectorised clip and a reference give a look, the clip's new boundary colours g'.

Only the colours of the key frames are moved, by sliced optimal mass transport (eq. 7, 8); no pixel is read. The
transport of a person is one map for the whole clip: it serves all their faces and key frames, so that a look does
not change at a cut and light that differs between shots stays. A key frame that is lit more or less brightly takes the
map relative to its exposure (`looks/exposure.py`), so that light that changes stays light.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import Literal

import numpy as np

from pvg._arrays import Doubles, Floats
from pvg._checks import check_word, real_number, whole_number
from pvg.asset import FaceRecord, FaceSummary, KeyFrame, VectorVideo, check_vectorized, faces_by_index
from pvg.face import PARTS
from pvg.haze import shown_through
from pvg.looks.apart import parts_apart
from pvg.looks.color_map import TransportSteps
from pvg.looks.exposure import KeyExposure, at_exposure, leading_key
from pvg.looks.haze import under_haze, with_less_haze
from pvg.looks.key_light import with_lit_skin
from pvg.looks.look import CONTRAST_RANGE, EXTENTS, PROTECTABLE, Contrast, FaceContrast, Look, LookMap, protected
from pvg.looks.parts import MAKEUP, Makeup, strengths
from pvg.looks.person_map import Goal, PersonMap
from pvg.looks.scene import SCENE
from pvg.looks.transport import BETA, ITERATIONS

MAX_ITERATIONS = 10_000  # more change nothing, but take for ever
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


def _reference_key(reference: VectorVideo, face: int | None, *, semantic: bool) -> KeyFrame:
    record = reference.records[reference_face_of(reference, face).index]
    return with_lit_skin(leading_key([with_less_haze(record) if semantic else record]))


def _check(contrast: Contrast, match: str, extent: str) -> Contrast:
    """The contrast. Raises `ValueError` for words that are none of these and a contrast out of range."""
    check_word("match", match, ("color", "semantic"))
    check_word("extent", extent, EXTENTS)
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
    Raises `ValueError` on a parameter out of range, an unknown face or part, and a path in the place of a video.
    """
    check_vectorized(video, reference)
    contrast, kept = _check(contrast, match, extent), protected(protect)
    semantic = match == "semantic"
    goal = Goal(
        semantic=semantic,
        contrast=contrast,
        strength=real_number("strength", strength, 0.0, 1.0),
        light=real_number("light", light, 0.0, 1.0),
        scene=real_number("scene", scene, 0.0, 1.0),
        target=_reference_key(reference, reference_face, semantic=semantic),
        steps=_steps(beta, iterations, seed),
        makeup=strengths(makeup),
    )
    chosen = faces_by_index(video, faces)
    follow_exposure = video.settings["matching"] != "chain"  # the paper's way moves every key frame by the same map
    new: dict[int, _NewFace] = {}
    # "color" takes colours as they are, as the paper does
    records = [with_less_haze(record) if semantic else replace(record, haze=0) for record in video.records]
    for person in video.persons:
        wanted = [index for index in person if index in chosen]
        if wanted:
            own = PersonMap.of([records[index] for index in person], goal, follow_exposure=follow_exposure)
            new |= {index: _new_face(video.records[index], records[index], own, goal) for index in wanted}
    return _look(new, goal, kept, body=extent == "skin", source_sha256=video.source_sha256)


def _steps(beta: float, iterations: int, seed: int) -> TransportSteps:
    """The parameters of eq. (7). Raises `ValueError` for one out of range."""
    beta = real_number("beta", beta, 0.0, 1.0)
    if beta == 0.0:
        raise ValueError("beta must be above 0: no step of eq. (7) would move a colour")
    return TransportSteps(beta, whole_number("iterations", iterations, 0, MAX_ITERATIONS), whole_number("seed", seed))


@dataclass(frozen=True, eq=False)
class _NewKey:
    """What a key frame gets, strength applied.

    colors: (S, 3) float32 g', 0-255 RGB;  parts: (P, 3) float32 that parts gain besides, None where they go with F.
    """

    colors: Floats
    parts: Floats | None
    exposure: KeyExposure


@dataclass(frozen=True, eq=False)
class _NewFace:
    """What a face gets at its K key frames, see `Look`."""

    colors: Floats
    contrast: FaceContrast
    parts: Floats | None
    map: LookMap


def _new_face(own: FaceRecord, clear: FaceRecord, person: PersonMap, goal: Goal) -> _NewFace:
    """The new boundary colours of a face, by the map of its person;  clear: the face by `with_less_haze`."""
    keys = [_new_key(with_lit_skin(key), person, goal) for key in clear.key_frames]
    before = zip(own.key_frames, clear.key_frames, keys, strict=True)
    colors = [under_haze(key.colors, plain.colors, new.colors, clear.haze) for key, plain, new in before]
    parts = [shown_through(clear.haze) * key.parts for key in keys if key.parts is not None]
    exposures = np.array([key.exposure.row() for key in keys], np.float32)
    return _NewFace(
        colors=np.stack(colors).astype(np.float32),
        contrast=1.0 if person.skin is None else "map",
        parts=np.stack(parts) if parts else None,
        map=LookMap(person.whole, goal.strength, exposures, beard=person.beard, haze=clear.haze),
    )


def _new_key(key: KeyFrame, person: PersonMap, goal: Goal) -> _NewKey:
    """The new boundary colours of a key frame: g' = kept · t · F(g / (gain · t)), and `strength` of the way there."""
    lit, strength = goal.relit(key), np.float32(goal.strength)
    exposure = person.exposure_of(lit)
    lit = at_exposure(lit, 1.0 / exposure.light)
    moved, parts = person.at_curves(lit), None
    if person.skin is not None:
        lacks = np.zeros((len(PARTS), 3), np.float32)
        if goal.contrast != "auto":  # F, where it draws pixels, takes parts along
            moved, lacks = parts_apart(lit, person.skin, moved, goal.contrast)
        if goal.changes is not None:
            parts = strength * exposure.shown(lacks + goal.changes.on(person.skin, lit, goal.makeup))
    new = _into_gamut(exposure.kept * exposure.tint * moved).astype(np.float32)
    colors = key.colors + strength * (new - key.colors)
    return _NewKey(colors, parts, exposure)


def _look(new: Mapping[int, _NewFace], goal: Goal, protect: tuple[str, ...], *, body: bool, source_sha256: str) -> Look:
    """The look of some faces.  body: whether the other skin of their persons goes along."""
    contrast: float | dict[int, FaceContrast]
    if goal.contrast == "auto":
        contrast = {index: face.contrast for index, face in new.items()}
    else:
        contrast = 1.0 + goal.strength * (goal.contrast - 1.0)
    return Look(
        colors={index: face.colors for index, face in new.items()},
        contrast=contrast,
        protect=protect,
        parts={index: face.parts for index, face in new.items() if face.parts is not None},
        maps={index: face.map for index, face in new.items()},
        body=frozenset(new if body else ()),
        source_sha256=source_sha256,
    )


def _into_gamut(colors: Doubles) -> Doubles:
    """Colours (n, 3) darkened to at most 255 in their own hue: cut channel by channel they would turn white."""
    positive = np.maximum(colors, 0.0)
    return np.asarray(positive * np.minimum(1.0, 255.0 / np.maximum(positive.max(axis=1, keepdims=True), 1.0)))
