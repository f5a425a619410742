"""The skin of a face through a clip: the key frame's shape carried along, occluders, the matte in time."""

from __future__ import annotations

from dataclasses import dataclass

from pvg.skin.parameters._range import Range


@dataclass(frozen=True)
class OcclusionNumbers:
    """Things of another hue in front of the face."""

    foreign_rise: Range = (4.0, 7.0)  # spreads off the skin's hue line [by eye]: from skin to another thing
    visible_rise: Range = (15.0, 25.0)  # L [by eye]: darker cells show no hue
    most_chroma: float = 1.6  # times the skin's [by eye]: flushed, or in deep shade
    known: float = 0.95  # of a cell that was open skin on the key frame [by eye]
    least_part: float = 0.006  # squared face sizes [by eye]: smaller spots are blemishes, or lips that moved
    between: float = 0.16  # face sizes [by eye]: half of the widest gap, a brow and an eye
    soft: float = 0.7  # cells, standard deviation of the occluder's edge [by eye]
    harden: float = 2.0  # times that edge's alpha, up to 1 [measured: half the tint on a bar before the face]


@dataclass(frozen=True)
class WarpNumbers:
    """The warp that carries the key frame's shape."""

    knot_step: int = 4  # every so many'th of the stacked landmarks is a centre [by eye]
    width: float = 0.6  # standard deviation of the Gaussians, in the centres' own spread [by eye]
    stiffness: float = 0.02  # [by eye]: the shape follows the landmarks, it need not hit them
    grid: int = 8  # cells between the nodes at which the warp is evaluated [by eye]


@dataclass(frozen=True)
class TrackingNumbers:
    """The matte of a clip, frame by frame."""

    least_cells: int = 192  # along the longer side of a matte [by eye]: for boxes of up to 768 px
    most_cells: int = 256  # the same for boxes from 1024 px [measured: 384 flicker less but double the asset]
    cell_px: float = 4.0  # source pixels a cell between both [by eye]
    least_side: int = 8  # cells along a side of any raster [by eye]
    brighter: float = 0.9  # of the light's change [by eye]: below, what is clipped has lost its hue since the key frame
    clipped: float = 250.0  # 8-bit levels [by eye]
    burnt: float = 0.25  # share of the face that is clipped [by eye]: above, nothing in front of it is told
    prior_weight: float = 0.6  # of the prior's log-odds [by eye]
    shape_slope: float = 60.0  # nats a face size of distance to the carried edge [by eye]
    shape_most: float = 6.0  # nats [by eye]
    neck_release: float = 0.6  # of the carried shape's log-odds lost on the neck [by eye]: it does not turn with the
    # head
    hair_margin: float = 0.02  # face sizes outside the carried shape where hair is looked for [by eye]
    filter_radius: float = 0.035  # face sizes, of the guided filter [by eye]
    filter_epsilon: float = 120.0  # squared 8-bit levels, of the guided filter [by eye]
    keep: float = 0.6  # weight of the frame before where nothing changed [measured: 0.8 flickers more, 0 is worse]
    change: float = 6.0  # 8-bit levels that end it [measured: tolerating more lags and flickers more]
    change_window: int = 5  # cells over which change is averaged [by eye]
    hysteresis: float = 0.3  # of probability for what the mask before said [by eye]
    edge_blur: float = 2.0  # cells [measured: with 2.5 colours beside an occluder step by 2.4 levels instead of 2.1]
    edge_rise: Range = (0.2, 0.65)  # probability [measured: from 0.15 rims gain 2 %, hair 2 %; from 0.3 both lose]
    edge_core: Range = (0.03, 0.97)  # of the blurred mask [by eye]: the matte is 0 below and 1 above
    alpha_step: int = 5  # 8-bit levels of alpha are multiples of it [measured: as good as all 256]


@dataclass(frozen=True)
class ConsensusNumbers:
    """What the frames around may not overrule, by how far the picture is off its median of five, 8-bit levels."""

    passing: Range = (30.0, 60.0)  # [by eye]: something large passes, from noise and glints of glasses on
    around: int = 5  # cells [by eye]: twice, and one, how far an edge may be off where it usually is
    # of a cell's alpha, 0-255, off its median: from which to which it is held to that where the picture is alike
    off: Range = (48.0, 112.0)  # [measured: from 96 on a strip blinks by a fifth, from 0 on edges in the dark lag]
    part: int = 7  # cells [by eye]: the least width of such a thing
    body_around: int = 3  # both of a body, whose cells are larger [by eye]
    body_part: int = 3  # a finger [by eye]
    colored: Range = (6.0, 14.0)  # [by eye]: something of another hue than skin passes
