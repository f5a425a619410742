"""Where skin is by place alone: the face's box, head, ears, neck and the regions between the features."""

from __future__ import annotations

from dataclasses import dataclass

from pvg.skin.parameters._range import Range


@dataclass(frozen=True)
class BoxNumbers:
    """The face's size and its box."""

    size_height: float = 0.8  # of the height that counts in a face size [by eye]
    beside: float = 0.22  # face sizes beside the oval [by eye]: ears
    above: float = 0.26  # face sizes above and below the oval [by eye]: a high forehead
    crown: float = 0.6  # face sizes above the oval [by eye]: a bald head's crown
    cut: float = 0.3  # of the oval's width [by eye]: skin so wide at the box's top goes on above it
    neck_half_width: float = 0.72  # face sizes [by eye]: where a neck runs into shoulders
    neck_end: float = 1.12  # face sizes below the chin [by eye]: the box's end
    fade_begins: float = 0.75  # face sizes below the chin [by eye]: from here the matte fades to the box's end
    side_fade: float = 0.06  # face sizes [by eye]: the matte fades along all sides of its raster
    least_upright: float = 0.2  # length of the sum of face's and picture's down [by eye]: less is a head upside down


@dataclass(frozen=True)
class HeadNumbers:
    """Log-odds of skin on the head by the signed distance to the face's contour, positive inside.

    Cheeks and jaw have a sharp edge; the forehead a lenient one, for fringes hang far into the contour and bald heads
    rise far above it.
    """

    cheek_inside: float = 40.0  # nats a face size [by eye]
    cheek_most: float = 6.0  # nats [by eye]
    cheek_outside: float = 30.0  # nats a face size [by eye]
    forehead_edge: float = 0.3  # nats on the contour [by eye]
    forehead_inside: float = 8.0  # nats a face size [by eye]
    forehead_most: float = 1.8  # nats [by eye]
    forehead_outside: float = 11.0  # nats a face size [by eye]
    crown_outside: float = 4.0  # the same where a head is bald [by eye]: colour decides
    crown_beside: Range = (0.3, 0.42)  # of the oval's width off its axis [by eye]: temples keep their hair
    forehead_begins: float = 0.15  # face sizes below the brows [by eye]: the cheek's rule begins to give way
    forehead_full: float = 0.08  # face sizes above the brows [by eye]: the forehead's rule alone


@dataclass(frozen=True)
class EarNumbers:
    """Odds of skin at the ears: a Gaussian beside the contour."""

    beside: float = 0.07  # face sizes outside the widest part of the oval [by eye]: its centre
    below: float = 0.04  # face sizes below the middle between eyes and nose [by eye]: its centre
    width: float = 0.08  # face sizes, standard deviation across the face [by eye]
    height: float = 0.16  # face sizes, standard deviation along the face [by eye]
    odds: float = 2.4  # odds of skin at its centre [measured: 92 % of labelled ears, 88 at 1.2; IoU falls at 3]
    floor: float = 1e-4  # odds of skin far away [by eye]
    reach: float = 8.0  # fall of its exponent beyond which the floor is taken alone [by eye]
    none: float = -9.2  # nats, the floor's [by eye]
    least: float = -3.0  # nats [by eye]: cells above it may belong to an ear that hair cuts off


@dataclass(frozen=True)
class NeckNumbers:
    """Log-odds of skin on the neck, by the way from the chin along it and the distance off its axis."""

    begins: float = 0.45  # face sizes above the chin [by eye]
    none: float = -9.0  # nats above that [by eye]
    reach: float = 2.0  # face sizes below the chin [by eye]: nothing changes further on
    half_width: float = 0.40  # face sizes at the chin [by eye]
    widening: float = 0.30  # face sizes more, times the way to the power 1.5 [by eye]: towards the shoulders
    edge: float = 14.0  # nats a face size across the neck's edge [by eye]
    axis: float = 1.0  # nats under the chin [by eye]
    fall: float = 0.6  # nats less a face size below the chin [by eye]: collars
    head: float = 12.0  # nats less where the head begins [by eye]
    head_rise: Range = (0.35, 0.6)  # face sizes above the chin [by eye]: where the head begins
    weight_rise: Range = (-0.2, 0.1)  # face sizes below the chin [by eye]: from head to neck

    chest_rise: Range = (0.2, 0.5)  # face sizes below the chin [by eye]: from neck to chest
    chest_fade: float = 0.15  # face sizes to either side of that edge [by eye]: a bare chest fades there


@dataclass(frozen=True)
class RegionNumbers:
    """Regions of a face that are told from the landmarks alone, in face sizes, and the limits of the prior."""

    least: float = -7.0  # nats [by eye]: the prior's lower limit
    most: float = 6.0  # nats [by eye]: the prior's upper limit
    core: float = 0.86  # of the contour, shrunk to its middle [by eye]: certainly face
    below_brows: float = 0.05  # face sizes [by eye]: the certain face begins below fringes
    above_lips: float = 0.03  # face sizes above the lips' middle [by eye]: the colour sample ends above beards
    below_eyes: float = 0.15  # face sizes [by eye]: cheeks begin below glasses
    feature_margin: float = 0.03  # face sizes [by eye]: lashes, brow hairs and lip contours spill over
    beard_length: float = 0.12  # face sizes along the neck [by eye]: a beard or shadow that is closed over
    beard_along: Range = (-0.3, 0.4)  # face sizes below the chin [by eye]: where
    beard_off: float = 0.4  # face sizes off the neck's axis [by eye]: likewise
