"""The skin of one picture: colours, how they are learned, what covers the face, the cut and what is cleaned up."""

from __future__ import annotations

from dataclasses import dataclass

from pvg.skin.parameters._range import Range


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
    least_part: float = 0.004  # squared face sizes [by eye]: smaller parts are no ear, nor a part of a face that is cut
    bridge: float = 0.06  # face sizes [by eye]: half the width of what may be no neck
    neck_weight: float = 0.9  # [by eye]: cells of more are the neck's


@dataclass(frozen=True)
class LightNumbers:
    """Dim and tinted pictures are told in the light in which people are photographed."""

    level: float = 160.0  # of a face's brightest channel, 8-bit [measured: 128 and 170 on clips at 5 to 25 % of light]
    most: float = 5.0  # times [by eye]: beyond there is but noise
    lit: tuple[float, ...] = (0.77, 0.81, 0.85, 0.89, 0.93)  # quantiles of a face's levels [measured: beside one alone]
    hue: float = 48.0  # degrees of CIELAB [measured: the middle of 40 faces of the media folder, 28 to 80]
    strange: Range = (33.0, 48.0)  # degrees off it [measured: as above]: from a skin's own hue to the light's
    hueless: Range = (2.0, 4.0)  # chroma [by eye]: from greys, whose hue is chance, to colours
    chroma: Range = (15.0, 25.0)  # of skin in usual light [by eye]
    reddest: float = -16.0  # degrees off that hue [measured: of those faces -14]: redder and paler skin is the white's
    reddened: float = 6.0  # degrees more [by eye]: from skin's own red to that of a camera's white
    # chroma of usual and of reddened skin at L 54, elsewhere times the root of (L + 16) / 70 [measured: of those faces
    # 12 at least; at most 34 at L 40 and 40 at L 67]
    palest: float = 8.5  # [measured: from 12 on an ear in haze is lost]
    palest_red: float = 13.0  # [measured: hands in a cool white; 51 % at 9, 86 % from 12 on]
    most_vivid: float = 38.0  # [measured: of those faces; white hair in warm white 43 % taken for skin before, 10 now]
    few: float = 95.0  # per cent of a face's surroundings [measured: with `body.color_trust`]: fewer have more chroma
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
class PaperNumbers:
    """The paper's rule."""

    red_chroma: tuple[int, int] = (140, 160)  # 8-bit Cr of skin, both ends included [paper]
