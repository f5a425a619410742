"""A look: new boundary colours for a clip, and how they are to be drawn."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from pvg._arrays import Doubles, Floats
from pvg._checks import real_number
from pvg.asset import VectorVideo
from pvg.face import PARTS
from pvg.looks.grey import told_from_grey
from pvg.looks.opponent import to_rgb
from pvg.looks.skin_map import SkinMap

CONTRAST_RANGE = (0.7, 1.5)  # of λ [paper]
PROTECTABLE = ("eyes", "teeth")

EXTENTS = ("skin", "face")  # all skin of a person, or the face with ears and neck

Contrast = float | Literal["auto"]
Region = Literal["face", "beside", "ears"]
"""Of a person's skin: the face, all that is beside it, and of that the ears in the face's matte."""
FaceContrast = float | Literal["map"]


@dataclass(frozen=True, eq=False)
class LookMap:
    """The map F of one face as a look draws it, on the face and on the person's other skin.

    strength: of the way from the skin's colours to those of F;
    exposures: (K, 5) gain, kept and tint of the face's key frames, see `KeyExposure`;
    beard: in [0, 1], see `beard_of`;
    haze: levels of it without which F is made and under which it is drawn, see `pvg.looks.haze`.
    """

    skin: SkinMap
    strength: float
    exposures: Floats
    beard: float = 0.0
    haze: int = 0

    def told_from_grey(self, luma: Doubles) -> Doubles:
        """(2, n) r of `pvg.rendering.tinge` up to which a colour of such lumas (n,) is grey, and from which on skin."""
        return told_from_grey(self.skin.alike, luma / self.skin.own.middle, self.beard)

    def usual_colors(self, region: Region = "face") -> tuple[Doubles, Doubles]:
        """The colours (256, 3) that are usual at the lumas 0 to 255, 0-255 RGB, and what F makes of them.

        The tone curve is T, `SkinMap.beside` or `SkinMap.ears`.
        """
        skin, levels = self.skin, np.arange(256.0)
        usual = to_rgb(np.column_stack([levels, skin.own.at(levels)]))
        if region == "face":
            tone, goal = skin.tone, skin.goal
        else:  # a neck may be brighter than the brightest of the face
            tone = skin.beside if region == "beside" else skin.ears
            goal = skin.goal.up_to(float(np.interp(skin.own.brightest, levels, tone)))
        return usual, to_rgb(np.column_stack([tone, goal.at(tone)]))


@dataclass(frozen=True, eq=False, repr=False)
class Look:
    """New boundary colours for a clip.

    colors: for each face index of the look, (K, S, 3) float32 g' of its K key frames, 0-255 RGB, strength applied;
    contrast: λ of u' = λI + H(g' − λg), strength applied: in [0.7, 1.5], or for each face index such a number or "map":
    u' = F(I) + H(g' − F(g)) with F of `maps`;
    protect: features that go their own way, of "eyes" and "teeth";
    parts: for each face index (K, P, 3) float32, luma, B − Y and R − Y in levels that each of `pvg.face.parts.PARTS`
    gains besides, strength applied; a face without them has no part of its own;
    maps: for each face index its one map of colour, light and parts aside;
    body: the face indices whose person's other skin goes along, by that map;
    source_sha256: of the clip that it is for, None where that is not said.

    Raises `ValueError` for colours of another shape, for a contrast that is no number in [0.7, 1.5] or leaves out
    a face, and where `maps` leaves out a face of `body` or of a contrast "map".
    """

    colors: dict[int, Floats]
    contrast: float | Mapping[int, FaceContrast] = 1.0
    protect: tuple[str, ...] = PROTECTABLE
    parts: dict[int, Floats] = field(default_factory=dict)
    maps: dict[int, LookMap] = field(default_factory=dict)
    body: frozenset[int] = frozenset()
    source_sha256: str | None = None

    def __post_init__(self) -> None:
        """Look at what was given; numbers of any kind become floats, sequences of any kind arrays or tuples."""
        if not isinstance(self.colors, Mapping):
            raise ValueError(f"colors must be by face, {{0: (K, S, 3)}}, not {type(self.colors).__name__}")
        for face, colors in self.colors.items():
            if (shape := np.shape(colors))[2:] != (3,):
                raise ValueError(f"the colors of face {face} must have the shape (K, S, 3), not {shape}")
        for face, parts in self.parts.items():
            if (shape := np.shape(parts))[1:] != (len(PARTS), 3):
                raise ValueError(f"the parts of face {face} must have the shape (K, {len(PARTS)}, 3), not {shape}")
        for name, of_faces in (("colors", self.colors), ("parts", self.parts)):
            object.__setattr__(self, name, {face: np.asarray(one, np.float32) for face, one in of_faces.items()})
        object.__setattr__(self, "protect", protected(self.protect))
        contrast = self._checked_contrast()
        by_map = [] if isinstance(contrast, float) else [face for face, one in contrast.items() if one == "map"]
        for what, faces in (('contrast is "map"', by_map), ("its body goes along", self.body)):
            if missing := sorted(set(faces) - set(self.maps)):
                raise ValueError(f"maps has nothing for face {missing[0]}, but {what}")
        object.__setattr__(self, "contrast", contrast)

    def _checked_contrast(self) -> float | dict[int, FaceContrast]:
        """λ as a number, or of each face. Raises `ValueError` for what is none, and where a face has none."""
        if not isinstance(self.contrast, Mapping):
            return real_number("contrast", self.contrast, *CONTRAST_RANGE)
        if missing := sorted(set(self.colors) - set(self.contrast)):
            raise ValueError(f"contrast has nothing for face {missing[0]}")
        return {face: _contrast(one) for face, one in self.contrast.items()}

    def __repr__(self) -> str:
        return f"<Look of {len(self.colors)} faces>"

    def check_fits(self, video: VectorVideo) -> None:
        """Raise `ValueError` unless this is a look of the clip: made for it, as it is vectorised now."""
        if self.source_sha256 is not None and self.source_sha256 != video.source_sha256:
            raise ValueError(f"the look is of another clip than {video.path.name}: transfer the colours to this one")
        for face, colors in self.colors.items():
            keys = video.records[face].key_frames if face in range(len(video.faces)) else ()
            parts = self.parts.get(face, keys)
            if not keys or colors.shape != (len(keys), *keys[0].colors.shape) or len(parts) != len(keys):
                raise ValueError(
                    f"the look does not fit face {face} as {video.path.name} has it: transfer the colours to this one"
                )

    def contrast_of(self, face: int) -> FaceContrast:
        """λ of one face of the look."""
        return self.contrast if isinstance(self.contrast, float) else self.contrast[face]

    @property
    def matte_key(self) -> Hashable:
        """What tells whose mattes are whose: looks of one clip with equal keys lie on the same pixels."""
        mapped = frozenset(face for face in self.colors if self.contrast_of(face) == "map")
        body = frozenset(face for face in self.body if self.maps[face].strength > 0.0)
        return frozenset(self.colors), frozenset(self.maps), mapped, body, frozenset(self.protect)

    def merged(self, other: Look) -> Look:
        """This look and another one of other faces, drawn as one.

        Raises `ValueError` when both change a face, are of different clips or protect different features.
        """
        _check_is_look(other)
        if self.source_sha256 != other.source_sha256:
            raise ValueError("looks of different clips cannot be merged")
        if both := sorted(set(self.colors) & set(other.colors)):
            raise ValueError(f"both looks change face {both[0]}; looks of different faces can be merged")
        if set(self.protect) != set(other.protect):
            raise ValueError("looks that protect different features cannot be merged")
        contrast = {face: look.contrast_of(face) for look in (self, other) for face in look.colors}
        parts, body, maps = self.parts | other.parts, self.body | other.body, self.maps | other.maps
        return replace(self, colors=self.colors | other.colors, contrast=contrast, parts=parts, body=body, maps=maps)


def check_looks(video: VectorVideo, looks: Iterable[object]) -> None:
    """Raise `ValueError` unless all of them are looks of the clip, see `Look.check_fits`."""
    for look in looks:
        _check_is_look(look).check_fits(video)


def _check_is_look(given: object) -> Look:
    if not isinstance(given, Look):
        raise ValueError(f"a look is what pvg.transfer or pvg.exchange returns, not {given!r}")
    return given


def protected(features: Sequence[str]) -> tuple[str, ...]:
    """The features that are to go their own way. Raises `ValueError` for what is none of `PROTECTABLE`."""
    if isinstance(features, str) or not isinstance(features, Collection):
        raise ValueError(f"protect must be a sequence of {', '.join(PROTECTABLE)}, not {features!r}")
    if unknown := [feature for feature in features if feature not in PROTECTABLE]:
        raise ValueError(f"cannot protect {unknown[0]!r}; known are {', '.join(PROTECTABLE)}")
    return tuple(features)


def _contrast(given: object) -> FaceContrast:
    return "map" if isinstance(given, str) and given == "map" else real_number("contrast", given, *CONTRAST_RANGE)
