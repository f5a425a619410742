"""Algorithm 1, transfer: a vectorised clip and a reference give a `Look`, the clip's new boundary colours.

Only the colours of the key frames are moved, by sliced optimal mass transport (eq. 7, 8); no pixel is read. The
transport of a person is one map for the whole clip: every face and key frame of theirs follows it, so that a look does
not change at a cut and light that differs between shots stays.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from pvg._arrays import Floats
from pvg.asset import KeyFrame, VectorVideo, faces_by_index
from pvg.curves import GROUPS, table_labels
from pvg.looks.tone import ComplexionMap
from pvg.looks.transport import sliced_transport

BETA = 0.2  # the paper's step
ITERATIONS = 20  # the paper's N
CONTRAST_RANGE = (0.7, 1.5)  # the paper's range for lambda
PROTECTABLE = ("eyes", "teeth")
_LIPS_WAY = 0.75  # of the way from where the light takes the lips to the reference's lips
_SMALLEST_GROUP = 8  # fewer visible samples say nothing about a group's colours
_LIPS = table_labels().group == GROUPS.index("lips")

_Map = Callable[[KeyFrame], NDArray[np.float64]]  # new boundary colours (S, 3) of a key frame
Contrast = float | Literal["auto"]


@dataclass(frozen=True, eq=False)
class Look:
    """New boundary colours for a clip.

    colors: for each face index of the look, (K, S, 3) float32 g' of its K key frames, 0-255 RGB, strength applied;
    contrast: lambda of `u' = lambda I + H(g' - lambda g)`, or "auto" for the field of METHOD 7b;
    strength: in [0, 1], already in `colors`, applied to the contrast when rendering; protect: features that keep
    their own colour.
    """

    colors: dict[int, Floats]
    contrast: Contrast = 1.0
    strength: float = 1.0
    protect: tuple[str, ...] = PROTECTABLE


def _reference_key(reference: VectorVideo) -> KeyFrame:
    """The key frame of the reference's largest face."""
    largest = max(reference.records, key=lambda record: record.summary.width_px)
    return largest.key_frames[0]


@dataclass(frozen=True)
class _Steps:
    """Parameters of eq. (7, 8)."""

    beta: float
    iterations: int
    seed: int

    def rng(self) -> np.random.Generator:
        """One generator a transport, seeded alike: a further look or face cannot shift another's rotations."""
        return np.random.default_rng(self.seed)


def _color_map(key: KeyFrame, target: KeyFrame, steps: _Steps) -> _Map:
    """The paper's way: all boundary colours of `key` transported together.

    What is hidden on either side takes no part, so that a clip's own colours stay as they are. The clip's hidden
    samples, and those of other key frames, then move as the transported ones of like colour do.
    """
    seen, wanted = key.colors[key.visible], target.colors[target.visible]
    if min(len(seen), len(wanted)) < _SMALLEST_GROUP:
        return lambda other: other.colors.astype(np.float64)
    moved = sliced_transport(seen, wanted, beta=steps.beta, iterations=steps.iterations, rng=steps.rng())

    def apply(other: KeyFrame) -> NDArray[np.float64]:
        if other is not key:
            return _follow_like_colors(other.colors, seen, moved)
        out = key.colors.astype(np.float64)
        out[key.visible] = moved
        if not key.visible.all():
            out[~key.visible] = _follow_like_colors(key.colors[~key.visible], seen, moved)
        return out

    return apply


def _part_map(key: KeyFrame, target: KeyFrame, steps: _Steps) -> _Map:
    """Skin to skin and lips to lips.

    The open skin's colours are transported, and the curves follow what that does to a complexion: brows and eyes go
    as they would in another light, so that no dark brow of the reference falls on a lid. Lips keep their own shades
    and go most of the way to the reference's lips. Without enough open skin on either side the curves' colours stand
    in for it.
    """
    if min(len(key.skin), len(target.skin)) == 0:
        return _color_map(key, target, steps)
    complexion = ComplexionMap.between(
        key.skin,
        sliced_transport(key.skin, target.skin, beta=steps.beta, iterations=steps.iterations, rng=steps.rng()),
    )
    ours, theirs = _lip_color(key), _lip_color(target)
    if ours is None or theirs is None:
        return lambda other: complexion(other.colors)
    beside_skin = _LIPS_WAY * (theirs - complexion(ours[None])[0])

    def apply(other: KeyFrame) -> NDArray[np.float64]:
        moved = complexion(other.colors)
        middle = _lip_color(other)
        if middle is not None:
            goal = complexion(middle[None])[0] + beside_skin
            moved[_LIPS] = goal + complexion.brightness * (other.colors[_LIPS] - middle)
        return moved

    return apply


def _lip_color(key: KeyFrame) -> Floats | None:
    """(3,) median of the visible lip samples, None when there are too few."""
    seen = _LIPS & key.visible
    if int(seen.sum()) < _SMALLEST_GROUP:
        return None
    return np.asarray(np.median(key.colors[seen], axis=0))


def _follow_like_colors(colors: Floats, seen: Floats, moved: NDArray[np.float64]) -> NDArray[np.float64]:
    """Colours (n, 3), each shifted by the mean shift of those of `seen` (m, 3), moved to `moved`, nearest to it."""
    count = min(_SMALLEST_GROUP, len(seen))
    distance, nearest = KDTree(seen).query(colors, k=count)
    weight = 1.0 / (np.asarray(distance) + 1.0)
    weight /= weight.sum(axis=1, keepdims=True)
    return np.asarray(colors + np.einsum("nk,nkc->nc", weight, (moved - seen)[nearest]))


def _check(strength: float, contrast: Contrast, match: str, protect: Sequence[str]) -> None:
    if not 0.0 <= strength <= 1.0:
        raise ValueError(f"strength must be in [0, 1], not {strength}")
    if contrast != "auto" and not (
        isinstance(contrast, (int, float)) and CONTRAST_RANGE[0] <= contrast <= CONTRAST_RANGE[1]
    ):
        raise ValueError(f'contrast must be "auto" or in [0.7, 1.5], not {contrast!r}')
    if match not in ("color", "semantic"):
        raise ValueError(f'match must be "color" or "semantic", not {match!r}')
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
    faces: Literal["all"] | Sequence[int] = "all",
    beta: float = BETA,
    iterations: int = ITERATIONS,
    seed: int = 0,
) -> Look:
    """Give the faces of `video` the face colours of `reference`'s largest face (eq. 7, 8).

    strength: in [0, 1], 0 leaves the clip as it is;  contrast: lambda in [0.7, 1.5], 1 as in the paper, or "auto" for
    a lambda that follows the brightness the transfer asks for;  match: "semantic" moves skin to skin and lips to lips,
    "color" transports all boundary colours together as the paper does;  protect: features that keep their own colour;
    beta, iterations: eq. (8), the paper's 0.2 and 20;  seed: of the random rotations.
    Raises `ValueError` on a parameter out of range or an unknown face.
    """
    _check(strength, contrast, match, protect)
    target = _reference_key(reference)
    steps = _Steps(beta, iterations, seed)
    make_map = _part_map if match == "semantic" else _color_map
    chosen = faces_by_index(video, faces)
    colors: dict[int, Floats] = {}
    for person in video.persons:
        if not set(person) & set(chosen):
            continue
        apply = make_map(_leading_key(video, person), target, steps)
        for index in person:
            if index not in chosen:
                continue
            new = []
            for key in video.records[index].key_frames:
                moved = _into_gamut(apply(key)).astype(np.float32)
                new.append(key.colors + np.float32(strength) * (moved - key.colors))
            colors[index] = np.stack(new).astype(np.float32)
    return Look(colors, contrast, strength, tuple(protect))


def _into_gamut(colors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Colours (n, 3) darkened to at most 255 in their own hue: cut channel by channel they would turn white."""
    positive = np.maximum(colors, 0.0)
    return np.asarray(positive * np.minimum(1.0, 255.0 / np.maximum(positive.max(axis=1, keepdims=True), 1.0)))


def _leading_key(video: VectorVideo, person: Sequence[int]) -> KeyFrame:
    """The key frame that a person's map is made from: of the face seen longest, if its skin could be sampled."""
    keys = [video.records[index].key_frames[0] for index in person]
    return next((key for key in keys if len(key.skin)), keys[0])
