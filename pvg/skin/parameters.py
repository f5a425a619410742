"""Every tuned number of the skin model, in one frozen `SkinPrior`.

Each number has its unit and its origin: [measured: …] on labelled portraits or on clips, see docs/quality.md, [paper],
or [by eye] on the same pictures. A *face size* is √(width · 0.8 height) of the face's oval, a length that a turn of the
head changes little; a *spread* is the robust standard deviation of a face's own skin along an axis of Lab; log-odds are
in nats. Ranges are where something rises from 0 to 1.
"""

from __future__ import annotations

from dataclasses import dataclass

Range = tuple[float, float]


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
class ClosingNumbers:
    """A morphological closing where something that is not skin-coloured has skin at both ends."""

    length: float  # face sizes
    along: Range  # face sizes below the chin, along the neck
    off: float  # face sizes off the neck's axis


@dataclass(frozen=True)
class RegionNumbers:
    """Regions of a face that are told from the landmarks alone, in face sizes, and the limits of the prior."""

    least: float = -7.0  # nats [by eye]: the prior's lower limit
    most: float = 6.0  # nats [by eye]: the prior's upper limit
    core: float = 0.86  # of the contour, shrunk to its middle [by eye]: certainly face
    below_brows: float = 0.05  # face sizes [by eye]: the certain face begins below fringes
    above_lips: float = 0.03  # face sizes above the lips' middle [by eye]: the colour sample ends above beards
    below_lips: float = 0.03  # face sizes [by eye]: the chin begins
    below_eyes: float = 0.15  # face sizes [by eye]: cheeks begin below glasses
    beard_reach: float = 0.25  # face sizes outside the contour [by eye]
    feature_margin: float = 0.03  # face sizes [by eye]: lashes, brow hairs and lip contours spill over
    brow_to_forehead: float = 0.14  # face sizes [by eye]
    chin_shadow: ClosingNumbers = ClosingNumbers(0.30, (-0.3, 0.5), 0.2)  # face sizes [by eye]
    beard: ClosingNumbers = ClosingNumbers(0.12, (-0.3, 0.4), 0.4)  # face sizes [by eye]
    brow_height: float = 0.16  # face sizes [by eye]: what is closed over the brows


@dataclass(frozen=True)
class ColorNumbers:
    """Colour distances and histograms, in Lab with chroma brought to one lightness."""

    lightness: float = 54.0  # L [by eye]: chroma is told as if all were as light
    darkest: float = 24.0  # L [by eye]: below it noise forbids to scale chroma up further
    spread_factor: float = 1.3  # times the sample's robust spread [by eye]: the sample is the middle of the face only
    least_spread: tuple[float, float, float] = (5.0, 1.6, 1.6)  # Lab [by eye]
    most_spread: tuple[float, float, float] = (9.0, 3.2, 3.2)  # Lab [by eye]
    bins: int = 48  # along each axis [by eye]
    reach: float = 9.0  # spreads to either side of the median [by eye]: colours beyond share the outer bins
    blur: float = 1.4  # bins, standard deviation [by eye]
    blur_width: int = 9  # bins [by eye]: the blur's support
    skin_floor: float = 0.03  # of a uniform density, added to skin's [by eye]
    around_floor: float = 0.3  # of a uniform density, added to the surroundings' [by eye]: unseen colours are not skin
    most_log_ratio: float = 5.0  # nats [by eye]
    lightness_discount: float = 0.7  # of squared L that the tonal distance leaves out [by eye]
    grey: float = 225.0  # squared spreads, times the square of the saturation that is missing [by eye]
    least_saturation: float = 0.55  # of the sample's chroma [by eye]: less is penalised
    full_chroma: float = 10.0  # Lab [by eye]: skin of less chroma is told from greys in proportion
    shade_rise: Range = (15.0, 35.0)  # L [by eye]: darker greys in the face may be a forehead under a hat


@dataclass(frozen=True)
class LearningNumbers:
    """How colours and mask of one picture are learned from each other."""

    face_px: float = 150.0  # pixels a face size [measured: IoU moves by < 0.001 for other sizes]: the working size
    rounds: int = 3  # [by eye]
    least_sample: int = 16  # cells [by eye]: fewer tell no colour
    glasses_darker: float = 15.0  # L darker than the cheeks [by eye]: dark glasses spoil the sample
    outlier: float = 16.0  # squared spreads [by eye]: eyes, lips, glasses and beard inside the certain face
    likeness_from: float = 9.0  # squared tonal spreads [by eye]: colours further from the sample teach less
    likeness_decay: float = 0.15  # a squared spread [by eye]
    first_from: float = 6.0  # squared spreads [by eye]: the first probabilities fall with the distance
    first_decay: float = 0.25  # a squared spread [by eye]
    around_from: float = 0.1  # face sizes outside the contour [by eye]: surroundings further off teach less
    around_decay: float = 2.0  # a face size [by eye]
    inside_weight: float = 0.2  # of the contour's inside as surroundings [by eye]: hair there is like hair above,
    # but shade is skin
    unsure: float = 0.8  # of what is like the sample above the brows [measured: bald foreheads, IoU moves by < 0.003]:
    # it does not count as surroundings
    prior_weight: float = 0.4  # of the prior's log-odds in learning [by eye]
    agree: float = 0.6  # probability at least of what a round's mask holds [by eye]
    disagree: float = 0.4  # probability at most of what it does not [by eye]
    unseen: float = -9.0  # nats outside the picture [by eye]
    refine_radius: float = 2.0  # working pixels [measured: IoU moves by < 0.001 for other filters of the edge]
    refine_epsilon: float = 100.0  # squared 8-bit levels [measured: as refine_radius]


@dataclass(frozen=True)
class BeardNumbers:
    """A full beard, of the colour that the chin shows, is the face's whatever lies behind it."""

    darker: float = 25.0  # L darker than the open skin [by eye]
    radius: float = 40.0  # 8-bit levels from the chin's median colour [by eye]
    log_odds: float = 0.5  # nats at least for skin [by eye]


@dataclass(frozen=True)
class ThroatNumbers:
    """A bare neck in a light of its own: its colour is taken for skin's too, where it can be."""

    along: Range = (0.12, 0.45)  # face sizes below the chin [by eye]: where it is seen
    off: float = 0.2  # face sizes off the neck's axis [by eye]
    shoulders: Range = (0.6, 1.0)  # face sizes below the chin [by eye]: where clothes are seen
    beside: float = 0.45  # face sizes off the neck's axis [by eye]
    darker: float = 15.0  # L darker than the face [by eye]: more is a beard, or a collar
    lighter: float = 8.0  # L lighter than the face [by eye]
    least_red: float = 2.5  # a, at one lightness [by eye]: less is a collar
    least_chroma: float = 0.2  # of the face's [by eye]: less is cloth
    hue: Range = (0.25, 1.45)  # radians, of a and b [by eye]: skin's
    uneven: float = 2.0  # spreads, length of the median deviation [measured: bare necks 0.5 to 1.5, collars 2.8 to 4.1]
    neck: float = 0.5  # weight of the neck [by eye]: cells of more take its colour
    cloth: float = 5.0  # spreads from what the shoulders show [by eye]: less is cloth


@dataclass(frozen=True)
class HairNumbers:
    """Hair over the forehead: a mixture of two colours in every cell."""

    log_odds: float = 7.0  # nats against skin where hair covers it [by eye]
    ring: Range = (0.06, 0.30)  # face sizes outside the contour [by eye]: where hair is seen, beyond a brim's shade
    least_ring: int = 30  # cells [by eye]
    fair_within: float = 20.0  # L [by eye]: hair that differs less from skin is told by its hue
    dark_noise: float = 10.0  # 8-bit levels, standard deviation of mixtures with dark hair [by eye]
    fair_noise: tuple[float, float, float] = (4.0, 1.5, 1.5)  # Lab, added to the spreads of fair hair and skin [by eye]
    inlier: float = 3.0  # robust standard deviations from the median [by eye]: what counts in those spreads
    inlier_margin: float = 1.0  # Lab, more [by eye]
    least_contrast: float = 2.0  # Mahalanobis distance of hair and skin [by eye]: less gives no direction
    dark_line: float = 0.35  # of the contrast [by eye]: colours further off the line are no mixture with dark hair
    fair_line: float = 0.7  # of the contrast [by eye]: the same for fair hair
    most: float = 1.2  # fraction of hair [by eye]: strands darker than the median
    near: float = 0.06  # face sizes, standard deviation [by eye]: of the average that says what skin looks like here
    coarse: int = 4  # cells of the picture a cell of that average [by eye]
    least_sigma: float = 0.5  # cells of that average [by eye]
    rounds: int = 4  # of average and fractions [by eye]
    bare: float = 2.0  # [by eye]: skin counts in that average until 1/bare of it is hair
    dark_trust: float = 0.05  # weight of the cheeks' colour beside that of skin nearby, dark hair [by eye]: with less,
    # a fringe that was taken for skin is the skin nearby
    fair_trust: float = 0.3  # the same for fair hair [by eye]
    cover_rise: Range = (0.33, 0.63)  # fractions of hair [by eye]: from a shade that may be skin's to hair
    fallen_rise: Range = (0.6, 0.9)  # covered part of what is above a brow's cell [by eye]: a gap between locks bares
    # no brow
    bare_log_odds: float = 1.4  # nats for skin where dark hair surely does not cover it, near the key frame's [by eye]
    bare_release: float = 0.7  # of what the key frame's shape says against skin there [by eye]: bowed foreheads rise
    bare_within: Range = (-0.16, -0.08)  # face sizes outside the key frame's mask [by eye]: how near


@dataclass(frozen=True)
class ShadeNumbers:
    """Skin in the deep shade of a brim."""

    darker: float = 0.35  # of the skin's brightness [by eye]: deeper shade shows no colour to tell skin by
    noise: float = 8.0  # 8-bit levels off the skin's colour times a factor [by eye]
    unlike_hair: Range = (25.0, 50.0)  # 8-bit levels from the hair or hat above [by eye]
    reach: float = 0.12  # face sizes outside the contour [by eye]: a brim stands off the forehead
    log_odds: float = 1.5  # nats at least for skin [by eye]


@dataclass(frozen=True)
class CutNumbers:
    """The minimum cut."""

    trust: float = 14.0  # weight of log-odds beside edges [measured: IoU moves by < 0.001 for other weights]
    limit: float = 10.0  # nats [by eye]
    certain: float = 6.5  # nats [by eye]: beyond, a cell is not to be cut at all
    chroma: float = 1.5  # weight of red chroma beside lightness in edges [by eye]


@dataclass(frozen=True)
class CleanupNumbers:
    """Connected components."""

    ear_gap: float = 0.12  # face sizes [by eye]: hair between an ear and the cheek
    least_part: float = 0.004  # squared face sizes [by eye]: smaller parts are no ear
    bridge: float = 0.06  # face sizes [by eye]: half the width of what may be no neck
    neck_weight: float = 0.9  # [by eye]: cells of more are the neck's


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
class LightNumbers:
    """Dim and tinted pictures are told in the light in which people are photographed."""

    level: float = 160.0  # of a face's brightest channel, 8-bit [measured: 128 and 170 on clips at 5 to 25 % of light]
    most: float = 5.0  # times [by eye]: beyond there is but noise
    hue: float = 48.0  # degrees of CIELAB [measured: the middle of 40 faces of the media folder, 28 to 80]
    strange: Range = (33.0, 48.0)  # degrees off it [measured: as above]: from a skin's own hue to the light's
    hueless: Range = (2.0, 4.0)  # chroma [by eye]: from greys, whose hue is chance, to colours
    chroma: Range = (15.0, 25.0)  # of skin in usual light [by eye]
    dimmest: float = 4.0  # 8-bit levels of the face's median colour [by eye]: limits the change of light
    change: Range = (0.2, 5.0)  # of light since the key frame, per channel, both in usual light: limits [by eye]


@dataclass(frozen=True)
class TintNumbers:
    """Light whose colour is not the same over a face, as planes of log R/G and log B/G."""

    cells: float = 20.0  # a face size [by eye]: the planes are fitted to some hundred
    least_cells: int = 40  # [by eye]: fewer say nothing
    dark: float = 8.0  # 8-bit levels [by eye]: darker cells show no colour
    clipped: float = 250.0  # 8-bit levels [by eye]: brighter ones have lost theirs
    outlier: float = 0.12  # of log chroma off the planes [by eye]: such cells count a quarter
    ridge: float = 0.002  # of the number of cells [by eye]
    rounds: int = 5  # of reweighting [by eye]
    tilt_rise: Range = (0.1, 0.2)  # of log chroma a face size [by eye]: from the skin's own to the light's
    steepest: float = 1.2  # of log chroma a face size [by eye]


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
class BodyNumbers:
    """The rest of a person's skin, in the whole picture: neck, chest, arms, hands."""

    cells: int = 256  # along the picture's longer side, at most [by eye]
    least_cell_px: float = 3.0  # source pixels a cell at least [by eye]: finer cells show noise
    least_side: int = 8  # cells along a side at least [by eye]
    person_every: int = 4  # frames from one mask of the network to the next [by eye]
    unexplained: float = 30.0  # levels of grey that cells are off those of the scene before, moved by the flow [by eye]
    much: float = 0.007  # of the cells that are [measured: fast hands 0.01 to 0.08, people who talk 0.005 and less]
    cube: int = 33  # nodes along each side of the table of colours [by eye]
    color_trust: Range = (3.0, 6.0)  # Lab chroma of the face from which on its colour finds other skin [by eye]
    base: float = 4.0  # nats for the face's own colour [by eye]
    along: Range = (2.1, 2.6)  # spreads of chroma, standard deviation towards grey and away from it [by eye]
    grey: float = 60.0  # nats times missing chroma squared [measured: greyish collars 14 % at 0, 7 at 40, 4 at 80]
    least_chroma: float = 0.5  # of the face's own at one lightness [by eye]: less is missing
    across: float = 1.8  # spreads of chroma across the hue, standard deviation [by eye]
    light_free: float = 2.5  # spreads of lightness that cost nothing [by eye]: a body is lit otherwise than a face
    light: float = 1.2  # spreads of lightness beyond, standard deviation [by eye]
    seen_for: float = 1.5  # nats at most by the colours of the key frame [by eye]
    seen_against: float = 4.0  # nats at most against skin by them [by eye]: hair and collars beside the face
    seen_weight: float = 0.8  # of them [by eye]
    person: float = 14.0  # nats from no person to a person [by eye]
    person_for: float = 1.0  # nats at most for being a person [by eye]
    no_person: float = 0.25  # of the person mask [by eye]: less is none
    any_person: Range = (0.05, 0.3)  # of the person mask [by eye]: where ears and neck of the face's matte may be
    head: float = 8.0  # nats against skin around the head [by eye]: what is not the face's matte there is hair
    head_beside: float = 0.40  # face sizes beside the oval [by eye]
    head_above: float = 0.5  # face sizes above the oval [by eye]
    head_below: float = -0.05  # face sizes below the chin [by eye]
    head_rise: Range = (0.85, 1.15)  # of that ellipse, where the head ends [by eye]
    ear_width: float = 0.08  # face sizes across the face [by eye]: standard deviation of where ears are
    ear_height: float = 0.18  # face sizes, standard deviation along the face [by eye]
    ear_rise: float = 3.0  # times that Gaussian, up to 1 [measured: at 2 a tenth less of red ears]
    ear_along: float = 8.0  # spreads of chroma, standard deviation away from grey at the ears [by eye]: blood
    ear_redder: float = 6.0  # the same across the hue, to red [measured: 73 % of reddened ears, 51 at 4, 33 at 1.8]
    ear_against: float = 0.5  # nats at most by the key frame's colours, from skin's chroma on [by eye]: a missed ear
    # counted as surroundings there
    ear_bare: float = 0.5  # of hair's log-odds not held against an ear [measured: 74 % of reddened ears, 50 at 0.3]
    ear_release: float = 0.95  # of `head` that is not held against an ear [by eye]
    ear_sure: Range = (-2.0, 1.0)  # nats by colour [by eye]: where an ear is one
    hair_above: float = 0.05  # face sizes above the chin [by eye]: parts beside the face begin
    hair_most: float = 0.12  # squared face sizes [by eye]: larger parts are no ears
    hair_cells: int = 6  # [by eye]: smaller parts and surroundings say nothing
    hair_reach: int = 3  # cells around a part [by eye]: its surroundings
    hair_least: float = 1.0  # nats, a part's mean of hair's log-odds [measured: as hair_alike]: less is no hair
    # hair is 0.5 to 3.9 spreads from what is around it; ears are 3.4 to 22, and little there speaks for hair
    hair_alike: float = 1.5  # spreads between a part and what is around it, beyond those nats [measured: as above]
    texture_from: float = 0.12  # standard deviation over brightness, of 3 cells a side [by eye]: skin is smooth
    texture: float = 20.0  # nats a unit more [by eye]
    texture_dark: float = 12.0  # 8-bit levels added to the brightness [by eye]
    neck: float = 4.0  # nats for what the face's mask calls neck [by eye]
    neck_rise: Range = (-0.15, 0.1)  # face sizes below the chin [by eye]: where it begins to
    network_weight: float = 0.5  # of the face's network's log-odds against skin [measured: hair and walls at 0 to 1]
    network_most: float = 2.0  # nats of it at most [measured: of 2 to 6; hands and ears lose by more]
    network_rise: Range = (1.1, 1.3)  # of the face's oval, off which it counts [by eye]: before the face hands are seen
    most: float = 7.0  # nats, the limit of the sum [by eye]
    blur: float = 0.7  # cells, of the log-odds [by eye]
    join: int = 5  # cells [by eye]: gaps narrower than this join parts
    least_part: float = 0.015  # squared face sizes of a part that does not touch the face [by eye]: a hand
    kept_part: float = 0.006  # the same when it was there in the frame before [by eye]
    sure: float = 0.7  # mean probability of such a part [measured: at 0.85 an arm is lost that the network doubts]
    part_person: float = 0.78  # mean of the person mask there [measured: hands 0.83 and more, floors 0.76 and less]
    kept_person: float = 0.7  # the same when it was there in the frame before [by eye]
    sure_alone: float = 0.88  # mean probability of a part with less of it [measured: hands 0.92, floors up to 0.82]
    raised_part: float = 4.0  # times as large above the chin [by eye]: what touches nothing there is a hand or no skin
    least_person: float = 0.25  # squared face sizes of the person mask away from the face [by eye]: an arm, no pot
    gap: float = 0.12  # face sizes [by eye]: half the widest gap between the mattes of face and body
    gap_face: float = 0.9  # of the face's matte [by eye]: what has less may be of a gap
    gap_predicted: float = 0.75  # probability at least that the network gives a gap [by eye]
    gap_hair: float = 1.0  # nats for hair at most [by eye]
    hole: float = 0.01  # squared face sizes [by eye]: larger holes in a person's skin show what is behind
    hole_probability: float = 0.9  # probability of skin in smaller ones [by eye]
    owner: float = 6.0  # power by which a nearer face owns a cell more [by eye]
    others_face: Range = (1.0, 1.2)  # of another's face's oval [by eye]: within it nothing is this person's
    neck_end: float = 0.5  # face sizes below the chin [by eye]: where a body begins


@dataclass(frozen=True)
class ConsensusNumbers:
    """What the frames around may not overrule, by how far the picture is off its median of five, 8-bit levels."""

    passing: Range = (30.0, 60.0)  # [by eye]: something large passes, from noise and glints of glasses on
    around: int = 5  # cells [by eye]: twice, and one, how far an edge may be off where it usually is
    part: int = 7  # cells [by eye]: the least width of such a thing
    colored: Range = (6.0, 14.0)  # [by eye]: something of another hue than skin passes


@dataclass(frozen=True)
class RingNumbers:
    """Hair beside the face and on the shoulders, by the colours of the ring around the head."""

    inner: float = 0.5  # of the half widths of what lies around the head [by eye]: the ring begins
    below: float = 0.1  # face sizes below the chin [by eye]: it ends
    apart: int = 3  # cells from the face's mask to it [by eye]: ears and skin's edge are no hair
    person: float = 0.8  # of the person mask [by eye]: in the ring, what is surely the person
    least: int = 40  # cells of ring and of face [by eye]: fewer tell no colour
    most_sample: int = 600  # cells of either, about [by eye]: more tell nothing more
    inlier: float = 3.0  # robust standard deviations [by eye]: colours further from the median are others'
    inlier_margin: float = 1.0  # spreads of the skin's colours, added to that [by eye]
    noise: float = 0.3  # spreads [by eye]: added to the standard deviations
    furthest: float = 20.0  # squared standard deviations [by eye]: colours beyond are like neither
    prior: float = 2.0  # nats for hair near the head [by eye]
    weight: float = 2.0  # of the log-ratio [by eye]
    most: float = 6.0  # nats [by eye]
    reach: Range = (1.4, 2.2)  # face sizes from the head's middle [by eye]: where hair ends
    far: float = 0.1  # of the weight, beyond [by eye]
    neck_rise: Range = (0.6, 1.0)  # of the oval's half width [by eye]: straight below the face is the neck, no hair


@dataclass(frozen=True)
class NetworkNumbers:
    """What the network is shown, and how far it is believed."""

    face_cells: float = 48.0  # cells a face size [by eye]: the network was trained so
    dark: float = 10.0  # 8-bit levels added before a logarithm [by eye]: as trained
    multiple: int = 16  # cells [by eye]: sides are multiples, for it halves four times
    sure: float = 0.001  # of probability [by eye]: nothing that is said is surer
    believed: float = 0.6  # of the log-odds, the rest the rules' [measured: 0.5 to 0.7 on pictures new to both]
    every: int = 4  # frames of a clip from one answer to the next [measured: mattes differ by 0.1 to 0.4 %]
    changed: float = 0.2  # of the cells, from which on it is asked at once [measured: at 0.25 occluders are tinted]


@dataclass(frozen=True)
class BodyNetworkNumbers:
    """What the network of the body is shown, and how far it is believed; the rest is as of the face's."""

    face_cells: float = 24.0  # cells a face size at most [by eye]: the network was trained so
    far: float = 3.0  # face sizes [by eye]: farther places are hardly told apart; as trained
    rise: Range = (1.3, 1.6)  # of the face's oval, off which it counts [measured: from 1.1 on red ears lose 7 %]
    margin: int = 8  # cells around the scene [by eye]: in training more lay around it
    believed: float = 0.6  # of the log-odds, the rest the rules' [measured: 0.6 to 1 on pictures new to both]


@dataclass(frozen=True)
class PaperNumbers:
    """The paper's rule."""

    red_chroma: tuple[int, int] = (140, 160)  # 8-bit Cr of skin, both ends included [paper]


@dataclass(frozen=True)
class SkinPrior:
    """All tuned numbers of the skin model, by stage."""

    box: BoxNumbers = BoxNumbers()
    head: HeadNumbers = HeadNumbers()
    ears: EarNumbers = EarNumbers()
    neck: NeckNumbers = NeckNumbers()
    regions: RegionNumbers = RegionNumbers()
    colors: ColorNumbers = ColorNumbers()
    learning: LearningNumbers = LearningNumbers()
    beard: BeardNumbers = BeardNumbers()
    throat: ThroatNumbers = ThroatNumbers()
    hair: HairNumbers = HairNumbers()
    shade: ShadeNumbers = ShadeNumbers()
    cut: CutNumbers = CutNumbers()
    cleanup: CleanupNumbers = CleanupNumbers()
    occlusion: OcclusionNumbers = OcclusionNumbers()
    light: LightNumbers = LightNumbers()
    tint: TintNumbers = TintNumbers()
    warp: WarpNumbers = WarpNumbers()
    tracking: TrackingNumbers = TrackingNumbers()
    body: BodyNumbers = BodyNumbers()
    consensus: ConsensusNumbers = ConsensusNumbers()
    ring: RingNumbers = RingNumbers()
    network: NetworkNumbers = NetworkNumbers()
    body_network: BodyNetworkNumbers = BodyNetworkNumbers()
    paper: PaperNumbers = PaperNumbers()


SKIN_PRIOR = SkinPrior()
