"""Algorithm 1, transfer: a vectorised clip and a reference give a `Look`, the clip's new boundary colours.

Only the colours of the key frames are moved, by sliced optimal mass transport (eq. 7, 8); no pixel is read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from pvg.asset import FaceRecord, KeyFrame, VectorVideo, faces_by_index
from pvg.complexion import ComplexionMap
from pvg.curves import GROUPS, Floats, table_labels
from pvg.transport import sliced_transport

BETA = 0.2  # the paper's step
ITERATIONS = 20  # the paper's N
CONTRAST_RANGE = (0.7, 1.5)  # the paper's range for lambda
PROTECTABLE = ("eyes", "teeth")
_LIPS_WAY = 0.75  # of the way from where the light takes the lips to the reference's lips
_SMALLEST_GROUP = 8  # fewer visible samples say nothing about a group's colours

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


def _transport_colors(key: KeyFrame, target: KeyFrame, steps: _Steps) -> NDArray[np.float64]:
    """The paper's way: all boundary colours together, (S, 3).

    What is hidden on either side takes no part, so that a clip's own colours stay as they are; the clip's hidden
    samples then move as its visible ones of like colour do.
    """
    moved = key.colors.astype(np.float64)
    visible, wanted = key.visible, target.visible
    if min(int(visible.sum()), int(wanted.sum())) < _SMALLEST_GROUP:
        return moved
    moved[visible] = sliced_transport(
        key.colors[visible], target.colors[wanted], beta=steps.beta, iterations=steps.iterations, rng=steps.rng()
    )
    _follow_like_colours(moved, key.colors, ~visible, visible)
    return moved


def _transport_parts(key: KeyFrame, target: KeyFrame, steps: _Steps) -> NDArray[np.float64]:
    """Skin to skin and lips to lips, (S, 3).

    The open skin's colours are transported, and the curves follow what that does to a complexion: brows and eyes go
    as they would in another light, so that no dark brow of the reference falls on a lid. Lips keep their own shades
    and go most of the way to the reference's lips. Without enough open skin on either side the curves' colours stand
    in for it.
    """
    if min(len(key.skin), len(target.skin)) == 0:
        return _transport_colors(key, target, steps)
    complexion = ComplexionMap.between(
        key.skin,
        sliced_transport(key.skin, target.skin, beta=steps.beta, iterations=steps.iterations, rng=steps.rng()),
    )
    moved = complexion(key.colors)
    lips = table_labels().group == GROUPS.index("lips")
    ours, theirs = lips & key.visible, lips & target.visible
    if min(int(ours.sum()), int(theirs.sum())) >= _SMALLEST_GROUP:
        middle = np.median(key.colors[ours], axis=0)
        as_skin = complexion(middle[None])[0]
        goal = as_skin + _LIPS_WAY * (np.median(target.colors[theirs], axis=0) - as_skin)
        moved[lips] = goal + complexion.brightness * (key.colors[lips] - middle)
    return moved


def _follow_like_colours(
    moved: NDArray[np.float64], colors: Floats, hidden: NDArray[np.bool_], visible: NDArray[np.bool_]
) -> None:
    """Shift each hidden sample by the mean shift of the visible samples nearest to it in colour, in place."""
    if not hidden.any():
        return
    shift = moved[visible] - colors[visible]
    count = min(_SMALLEST_GROUP, len(shift))
    distance, nearest = KDTree(colors[visible]).query(colors[hidden], k=count)
    weight = 1.0 / (np.asarray(distance) + 1.0)
    weight /= weight.sum(axis=1, keepdims=True)
    moved[hidden] += np.einsum("hk,hkc->hc", weight, shift[nearest])


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
    transport = _transport_parts if match == "semantic" else _transport_colors
    colors: dict[int, Floats] = {}
    for index in faces_by_index(video, faces):
        record: FaceRecord = video.records[index]
        new = []
        for key in record.key_frames:
            moved = np.clip(transport(key, target, steps), 0.0, 255.0).astype(np.float32)
            new.append(key.colors + np.float32(strength) * (moved - key.colors))
        colors[index] = np.stack(new).astype(np.float32)
    return Look(colors, contrast, strength, tuple(protect))
