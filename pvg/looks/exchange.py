"""Two faces of one clip exchange their colours, as the paper's Fig. 9 has it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict, Unpack

from pvg.asset import VectorVideo, check_vectorized, faces_by_index
from pvg.looks.look import Contrast, Look
from pvg.looks.parts import Makeup
from pvg.looks.transfer import transfer


class LookOptions(TypedDict, total=False):
    """The options of `transfer` that two looks share which exchange colours."""

    strength: float
    match: str
    makeup: Makeup
    light: float
    scene: float
    protect: Sequence[str]
    extent: str
    beta: float
    iterations: int
    seed: int


def exchange(
    video: VectorVideo,
    faces: Sequence[int],
    *,
    contrast: Contrast | Sequence[Contrast] = "auto",
    reference_face: int | None = None,
    **options: Unpack[LookOptions],
) -> Look:
    """One look of `video` in which two of its faces exchange their colours; all others stay as they are.

    faces: the indices of the two;  contrast: λ of both, or one for each in the order of `faces`: "auto" or a number;
    reference_face: None, since each is the other's reference;
    options: strength, match, makeup, light, scene, protect, extent, beta, iterations and seed of `transfer`, for both.
    Raises `ValueError` unless there are two different faces, and on a parameter out of range.
    """
    if reference_face is not None:
        raise ValueError("two faces exchange their colours: each is the other's reference, and reference_face is none")
    check_vectorized(video)
    chosen = faces_by_index(video, faces)
    if len(chosen) != 2 or chosen[0] == chosen[1]:
        raise ValueError(f"two different faces exchange their colours, not {list(chosen)}")
    first, second = chosen
    ours, theirs = contrast_of_both(contrast)
    return transfer(video, video, faces=[first], reference_face=second, contrast=ours, **options).merged(
        transfer(video, video, faces=[second], reference_face=first, contrast=theirs, **options)
    )


def contrast_of_both(contrast: Contrast | Sequence[Contrast]) -> tuple[Contrast, Contrast]:
    """λ of the first and of the second of two. Raises `ValueError` when it is neither one nor two."""
    if isinstance(contrast, Sequence) and not isinstance(contrast, str):
        if len(contrast) != 2:
            raise ValueError(f"contrast is one for both or one for each of the two, not {len(contrast)}")
        return contrast[0], contrast[1]
    return contrast, contrast  # what is neither "auto" nor a number is refused by `transfer`
