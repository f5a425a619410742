"""The map of a person: eq. (7, 8) taken from their leading key frame to the reference's, one for all their faces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pvg._arrays import Doubles, Floats
from pvg.asset import FaceRecord, KeyFrame
from pvg.curves import table_labels
from pvg.looks.beard import beard_of
from pvg.looks.color_map import SMALLEST_GROUP, ColorMap, TransportSteps, all_colors_map
from pvg.looks.complexion import complexion
from pvg.looks.depth import depth_of_features
from pvg.looks.exposure import AS_LEADING, Exposure, KeyExposure, Moved, leading_key, on_skin
from pvg.looks.key_light import with_lit_skin
from pvg.looks.light import light_ratio, relit
from pvg.looks.look import Contrast
from pvg.looks.parts import PartChanges
from pvg.looks.skin_map import SkinMap
from pvg.looks.tone import CRISP


@dataclass(frozen=True, eq=False, kw_only=True)
class Goal:
    """Where the colours of a clip are to go, and how; see `transfer`, strength, light and scene in [0, 1].

    target: the reference's key frame;  semantic: whether skin goes to skin, or all colours together;
    makeup: (P,) float32 in [0, 1], the strength of each part.
    """

    target: KeyFrame
    steps: TransportSteps
    semantic: bool
    contrast: Contrast
    strength: float
    light: float
    scene: float
    makeup: Floats

    @cached_property
    def changes(self) -> PartChanges | None:
        """What sets the reference's parts apart from its skin, None where parts go with it."""
        return PartChanges.of(self.target) if self.semantic and len(self.target.skin) else None

    def relit(self, key: KeyFrame) -> KeyFrame:
        """The key frame with light falling on the face as on the reference, as far as that is wanted."""
        return relit(key, light_ratio(key, self.target, self.light))


@dataclass(frozen=True, eq=False)
class PersonMap:
    """What the colours of a person go through, in all their faces and key frames.

    skin: F of the face, None with "color" and where there is too little open skin on either side;
    at_curves: the new boundary colours of a key frame, whose exposure is that of the leading one;
    exposure: of key frames beside the leading one, None where every one takes the map as it is;
    whole: F of all skin of the person, in the clip's own light;  beard: see `beard_of`.
    """

    skin: SkinMap | None
    at_curves: ColorMap
    exposure: Exposure | None
    whole: SkinMap
    beard: float

    @classmethod
    def of(cls, records: Sequence[FaceRecord], goal: Goal, *, follow_exposure: bool) -> PersonMap:
        """The map of the person whose faces these are, the one seen longest first."""
        leader = leading_key(records)
        warmth = next(record.warmth for record in records if any(key is leader for key in record.key_frames))
        plain = with_lit_skin(leader)
        leading = goal.relit(plain)
        skin = _skin_map(leading, goal, warmth) if goal.semantic else None
        at_curves = all_colors_map(leading, goal.target, goal.steps) if skin is None else _at_curves(skin)
        exposure = Exposure(leading, _skin_moved(skin, at_curves)) if follow_exposure else None
        # light falls on the face alone
        whole = skin if skin is not None and plain is leading else _whole_map(plain, goal, warmth)
        return cls(skin, at_curves, exposure, whole, beard_of(plain))

    def exposure_of(self, key: KeyFrame) -> KeyExposure:
        """The exposure of a key frame, see `Exposure.of`."""
        return AS_LEADING if self.exposure is None else self.exposure.of(key)


def _skin_moved(skin: SkinMap | None, at_curves: ColorMap) -> Moved:
    """F on the skin of a key frame: on its open skin, or on the curves there where it has none or F is theirs."""

    def moved(key: KeyFrame) -> tuple[Floats, Floats | Doubles]:
        if skin is not None and len(key.skin):
            return key.skin, skin(key.skin)
        seen = on_skin(key)
        return key.colors[seen], at_curves(key)[seen]

    return moved


def _at_curves(skin: SkinMap) -> ColorMap:
    """F at the curves: on skin with its k for patches, which H(g' − F(g)) then evens."""
    of_skin = table_labels().on_group("skin")[:, None]
    return lambda key: np.where(of_skin, skin.at_patches(key.colors), skin(key.colors))


def _skin_map(key: KeyFrame, goal: Goal, warmth: int) -> SkinMap | None:
    """The smooth map of the transport of the open skin; None without enough of it on either side.

    A number for λ is the contrast of all that lies between the curves: neither features nor shade get deeper then.
    warmth: see `pvg.warmth`.
    """
    if min(len(key.skin), len(goal.target.skin)) == 0:
        return None
    moved = goal.steps.transport(key.skin, complexion(goal.target.skin, key.skin, goal.scene, warmth))
    if goal.contrast != "auto":
        return SkinMap.between(key.skin, moved, bounded=goal.scene)
    return SkinMap.between(key.skin, moved, depth_of_features(key, goal.target), CRISP, bounded=goal.scene)


def _whole_map(key: KeyFrame, goal: Goal, warmth: int) -> SkinMap:
    """F of all skin of a person. Where the face has none of its own, the rest goes as the curves of its skin do."""
    skin = _skin_map(key, goal, warmth) if goal.semantic else None
    if skin is not None:
        return skin
    of_face = on_skin(key)
    if of_face.sum() < SMALLEST_GROUP:
        of_face = np.ones_like(of_face)
    moved = all_colors_map(key, goal.target, goal.steps)(key)
    return SkinMap.between(key.colors[of_face], moved[of_face])
