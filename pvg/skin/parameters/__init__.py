"""Every tuned number of the skin model, in one frozen `SkinPrior`; a module for each of its stages.

Each number has its unit and its origin: [measured: …] on labelled portraits or on clips, see docs/quality.md, [paper],
or [by eye] on the same pictures. A *face size* is √(width · 0.8 height) of the face's oval, a length that a turn of the
head changes little; a *spread* is the robust standard deviation of a face's own skin along an axis of Lab; log-odds are
in nats. Ranges are where something rises from 0 to 1.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from pvg.skin.parameters._range import Range
from pvg.skin.parameters.body import BodyNumbers, CollarNumbers, HighlightNumbers, RingNumbers
from pvg.skin.parameters.clip import ConsensusNumbers, OcclusionNumbers, TrackingNumbers, WarpNumbers
from pvg.skin.parameters.networks import BodyNetworkNumbers, NetworkNumbers, OutlineNumbers
from pvg.skin.parameters.picture import (
    CleanupNumbers,
    ColorNumbers,
    CutNumbers,
    HairNumbers,
    LearningNumbers,
    LightNumbers,
    PaperNumbers,
    ShadeNumbers,
    ThroatNumbers,
    TintNumbers,
)
from pvg.skin.parameters.place import BoxNumbers, EarNumbers, HeadNumbers, NeckNumbers, RegionNumbers

__all__ = ["SKIN_PRIOR", "Range", "SkinPrior"]


@dataclass(frozen=True)
class SkinPrior:
    """All tuned numbers of the skin model, by stage."""

    box: BoxNumbers = field(default_factory=BoxNumbers)
    head: HeadNumbers = field(default_factory=HeadNumbers)
    ears: EarNumbers = field(default_factory=EarNumbers)
    neck: NeckNumbers = field(default_factory=NeckNumbers)
    regions: RegionNumbers = field(default_factory=RegionNumbers)
    colors: ColorNumbers = field(default_factory=ColorNumbers)
    learning: LearningNumbers = field(default_factory=LearningNumbers)
    throat: ThroatNumbers = field(default_factory=ThroatNumbers)
    hair: HairNumbers = field(default_factory=HairNumbers)
    shade: ShadeNumbers = field(default_factory=ShadeNumbers)
    cut: CutNumbers = field(default_factory=CutNumbers)
    cleanup: CleanupNumbers = field(default_factory=CleanupNumbers)
    occlusion: OcclusionNumbers = field(default_factory=OcclusionNumbers)
    light: LightNumbers = field(default_factory=LightNumbers)
    tint: TintNumbers = field(default_factory=TintNumbers)
    warp: WarpNumbers = field(default_factory=WarpNumbers)
    tracking: TrackingNumbers = field(default_factory=TrackingNumbers)
    body: BodyNumbers = field(default_factory=BodyNumbers)
    highlights: HighlightNumbers = field(default_factory=HighlightNumbers)
    collar: CollarNumbers = field(default_factory=CollarNumbers)
    consensus: ConsensusNumbers = field(default_factory=ConsensusNumbers)
    ring: RingNumbers = field(default_factory=RingNumbers)
    network: NetworkNumbers = field(default_factory=NetworkNumbers)
    body_network: BodyNetworkNumbers = field(default_factory=BodyNetworkNumbers)
    outline: OutlineNumbers = field(default_factory=OutlineNumbers)
    paper: PaperNumbers = field(default_factory=PaperNumbers)


SKIN_PRIOR = SkinPrior()
