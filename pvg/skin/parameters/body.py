"""The rest of a person's skin, in the whole picture."""

from __future__ import annotations

from dataclasses import dataclass

from pvg.skin.parameters._range import Range


@dataclass(frozen=True)
class BodyNumbers:
    """The rest of a person's skin, in the whole picture: neck, chest, arms, hands."""

    cells: int = 256  # along the picture's longer side, at most [by eye]
    least_cell_px: float = 3.0  # source pixels a cell at least [by eye]: finer cells show noise
    least_side: int = 8  # cells along a side at least [by eye]
    person_every: int = 4  # frames from one mask of the network to the next [by eye]
    unexplained: float = 30.0  # levels of grey that cells are off those of the scene before, moved by the flow [by eye]
    much: float = 0.007  # of the cells that are [measured: fast hands 0.01 to 0.08, people who talk 0.005 and less]
    # people who talk have 0.004 at most, hands 0.01 to 1.6; `benchmarks.quality.jumps` has 3631 in a clip of fast hands
    # where nothing is asked for them, 3188 with 0.025, 2565 with 0.01, 2447 with 0.004
    other: float = 0.01  # of a face size squared [measured: as above] that is skin now, or none, by the rules
    cube: int = 33  # nodes along each side of the table of colours [by eye]
    # chroma around a face from which on colours tell of other skin [measured: around 31 faces 10 at least, in a cool
    # white too; around three of four that are nearly black and white 6 at most]
    color_trust: Range = (6.0, 10.0)  # Lab at one lightness [measured: as above]
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
    ear_crimson: Range = (0.5, 2.5)  # spreads across the hue to red, of an ear's shade [measured: 0 to 5; hair -4 to 0]
    ear_crimson_chroma: Range = (4.0, 8.0)  # spreads of chroma beyond the face's, of it [measured: 8 to 12]
    ear_blood: float = 3.0  # nats for skin there [by eye]
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
    hair_redder: float = 2.5  # spreads across the hue to red [measured: an ear 4.2, hair -1.7 to 0.6]: a part is an ear
    hair_lighter: float = 18.0  # L [measured: dark hair's lit strands to 16, ears before it 22 to 38]: likewise
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
    edge_soft: float = 0.8  # cells [measured: chosen blind over none 14 times of 20]: of the matte's edge
    join: int = 5  # cells [by eye]: gaps narrower than this join parts
    least_part: float = 0.015  # squared face sizes of a part that does not touch the face [by eye]: a hand
    sure: float = 0.7  # mean probability of such a part [measured: before ADR 0075, at 0.85 an arm is lost]
    part_person: float = 0.78  # mean of the person mask there [measured: hands 0.83 and more, floors 0.76 and less]
    sure_alone: float = 0.88  # mean probability of a part with less [measured: before 0075, hands 0.92, floors 0.82]
    stays: float = 0.1  # of either, less where it was kept before [measured: a shoulder's wavers by 0.05]
    least_person: float = 0.25  # squared face sizes of the person mask away from the face [by eye]: an arm, no pot
    gap: float = 0.12  # face sizes [by eye]: half the widest gap between the mattes of face and body
    gap_face: float = 0.9  # of the face's matte [by eye]: what has less may be of a gap
    gap_predicted: float = 0.75  # probability at least that the network gives a gap [by eye]
    gap_hair: float = 1.0  # nats for hair at most [by eye]
    gap_over: Range = (0.25, 0.4)  # of its outline that goes over into skin [measured: 0.25 collars, 0.46 skin]
    beyond: float = 0.8  # probability by the rules beyond the face's box [measured: 0.5 to 0.9 alike]: skin goes on
    hole: float = 0.01  # squared face sizes [by eye]: larger holes in a person's skin show what is behind
    hole_probability: float = 0.9  # probability of skin in smaller ones [by eye]
    owner: float = 6.0  # power by which a nearer face owns a cell more [by eye]
    neck_end: float = 0.5  # face sizes below the chin [by eye]: where a body begins


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
    neck_rise: Range = (0.6, 1.0)  # of the oval's half width [by eye]: straight below the face is the neck, no hair


@dataclass(frozen=True)
class CollarNumbers:
    """Cloth on a neck or chest that is brighter and paler than the skin it lies on."""

    below_chin: Range = (-0.1, 0.02)  # face sizes [by eye]: where collars begin
    skin: float = 0.5  # probability of what may be skin [by eye]
    edge: int = 4  # cells [by eye]: from the edge of what may be skin to what surely is
    around: float = 0.15  # face sizes, standard deviation [by eye]: of the mean of the skin inside
    brighter: Range = (1.1, 1.25)  # of its luma [by eye]
    paler: Range = (0.3, 0.5)  # of its chroma over luma [measured: to 0.8 a neck that is lit from a side loses 15 %]
    blur: float = 1.0  # cells [by eye]: what is found comes and goes with noise


@dataclass(frozen=True)
class HighlightNumbers:
    """Highlights on the skin off the face."""

    person: float = 0.5  # of the person mask [by eye]
    lighter: float = 1.0  # spreads of lightness beyond the face's, at least [by eye]
    pales: float = 0.5  # of missing chroma that light explains [measured: white cloth counts from 0.8 on]
    pales_rise: Range = (1.5, 4.0)  # spreads of lightness [by eye]: from none to that
    least: float = 0.015  # squared face sizes [by eye]: smaller parts are noise, and come and go
    step: float = 16.0  # CIE L and chroma at one lightness, from cell to cell [measured: with `share`]: an edge
    share: float = 0.4  # of the outline without one [measured: parts with it are skin by 89 % of their area]
    probability: float = 0.9  # of skin there [by eye]
