"""The rest of a person's skin: neck, chest, arms and hands, told in the whole picture by what the face taught.

In every cell of a scene the log-odds add up: how alike its colour is to the face's own, its hue more than its light;
what the key frame saw of that colour beside the face; the person mask; evenness; against what lies around the head,
which is hair or the face's; and for what the face's own mask calls neck. A network has its say off the face's oval, for
hair, cloth and walls of the skin's colour. What is likely skin then counts where it touches the face or makes a part
that is surely skin, and is made steady in time as the face's matte is.
"""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Floats, smoothstep
from pvg.face import Landmarks
from pvg.raster import Raster
from pvg.skin import body_network
from pvg.skin._kernels import BodyWeights, body_log_odds
from pvg.skin.cleanup import occupied
from pvg.skin.color_model import ColorScale, SkinColors, to_skin_lab
from pvg.skin.in_time import in_levels, soft_edge, weight_of_before
from pvg.skin.light import gain_back, gain_of, relit
from pvg.skin.matte import Matte
from pvg.skin.network import NetworkOutput, fused
from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.prior import HeadShape, ear_depth, head_shape, logistic
from pvg.skin.ring import hair_odds
from pvg.skin.scene import Scene

_BODY, _TRACKING, _NETWORK = SKIN_PRIOR.body, SKIN_PRIOR.tracking, SKIN_PRIOR.body_network
_WEIGHTS = BodyWeights(
    person=np.float32(_BODY.person),
    person_for=np.float32(_BODY.person_for),
    no_person=np.float32(_BODY.no_person),
    head=np.float32(_BODY.head),
    head_begins=np.float32(_BODY.head_rise[0]),
    head_ends=np.float32(_BODY.head_rise[1]),
    texture_from=np.float32(_BODY.texture_from),
    texture=np.float32(_BODY.texture),
    texture_dark=np.float32(_BODY.texture_dark),
    ear_beside=np.float32(SKIN_PRIOR.ears.beside),
    ear_width=np.float32(_BODY.ear_width),
    ear_height=np.float32(_BODY.ear_height),
    ear_reach=np.float32(SKIN_PRIOR.ears.reach),
    ear_rise=np.float32(_BODY.ear_rise),
    ear_bare=np.float32(_BODY.ear_bare),
    ear_release=np.float32(_BODY.ear_release),
    ear_begins=np.float32(_BODY.ear_sure[0]),
    ear_ends=np.float32(_BODY.ear_sure[1]),
    known=np.float32(_BODY.known),
    known_begins=np.float32(_BODY.known_rise[0]),
    known_ends=np.float32(_BODY.known_rise[1]),
    most=np.float32(_BODY.most),
)
_TOUCHING = 2  # cells around the face's mask that a part touches it by
_SIDE_BY_SIDE = 0.5  # of a face's width: faces nearer to each other are one
_STOOD = 0.3  # of a part: so much of it was there before
_EDGE_BLUR = 1.0  # cells around the mask's edge
_LEAST_CHROMA = 1.0  # Lab: below it a hue has no direction


def color_tables(colors: SkinColors) -> tuple[Floats, Floats]:
    """Log-odds of skin by colour alone, everywhere and at the ears: (n, n, n) float32 at even steps of R, G, B to 255.

    Ears are thin and full of blood: they may be redder, darker and of more chroma than the face.
    """
    levels = np.linspace(0, 255, _BODY.cube).astype(np.float32)
    grid = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1).reshape(_BODY.cube, -1, 3)
    lab = to_skin_lab(np.asarray(grid, np.float32))
    center, spread = colors.scale.center, colors.scale.spread
    tone = center[1:]
    chroma = max(float(np.hypot(*tone)), _LEAST_CHROMA)
    off = lab[..., 1:] - tone
    unit = float(spread[1:].mean())
    along = (off @ tone) / chroma
    across = (off[..., 1] * tone[0] - off[..., 0] * tone[1]) / chroma / unit
    missing = np.maximum(0, _BODY.least_chroma - 1 - along / chroma)
    grey = _BODY.grey * missing**2 * min(1.0, chroma / SKIN_PRIOR.colors.full_chroma)
    along = along / unit
    away = (lab[..., 0] - center[0]) / spread[0]
    light = np.maximum(np.abs(away) - _BODY.light_free, 0) / _BODY.light
    seen = colors.evidence(lab)

    def table(against: Floats | float, more: float, redder: float) -> Floats:
        squares = (along / np.where(along < 0, _BODY.along[0], more)) ** 2
        squares += (across / np.where(across < 0, redder, _BODY.across)) ** 2 + light**2
        by_histogram = _BODY.seen_weight * np.clip(seen, -against, _BODY.seen_for)
        odds = _BODY.base - 0.5 * squares - grey + by_histogram
        return np.ascontiguousarray(odds.reshape((_BODY.cube,) * 3), np.float32)

    # a wall beside an ear is no ear: only what has the face's chroma or more
    at_ears = np.where(along > 0, _BODY.ear_against, _BODY.seen_against)
    return (
        table(_BODY.seen_against, _BODY.along[1], _BODY.across),
        table(at_ears, _BODY.ear_along, _BODY.ear_redder),
    )


class BodyTracker:
    """Makes the matte of a person's skin off the face in each scene of a track, in order."""

    def __init__(self, colors: SkinColors, light: Floats) -> None:
        """colors: learned on the key frame;  light: (3,) RGB, the face's colour there.

        Sets `color_trust`: in [0, 1], how far the face's skin has chroma enough to find its person's other skin by.
        """
        self._tables = color_tables(colors)
        self._scale = colors.scale
        self._light = light
        self.color_trust = float(smoothstep(np.hypot(*colors.scale.center[1:]), *_BODY.color_trust))
        # what one scene leaves to the next: its picture (h, w, 3), and (h, w, 3) probability, mask and alpha
        self._before: tuple[Bytes, Floats] | None = None
        self._hair: Floats | None = None  # of the scene before
        self._predicted: Floats | None = None  # by the network, likewise
        self._scenes = 0

    def step(
        self, scene: Scene, landmarks: Landmarks, face: Matte, light: Floats, output: NetworkOutput | None = None
    ) -> Matte:
        """The matte in the next scene, over the whole picture.

        landmarks: of the face, source pixels;  face: its own matte;  light: (3,) RGB, its colour now;
        output: the network's for the face's box.
        """
        own = landmarks.in_cells(scene.raster)
        head = head_shape(own)
        xs, ys = (np.asarray(v, np.float32) for v in scene.raster.centers())
        known = face.raster.read(face.mask.astype(np.float32), xs, ys)
        gain = gain_back(self._light, light)
        log_odds = np.empty(scene.raster.shape, np.float32)
        person = _own_people(scene.person, known, head.size)
        maps = scene.before
        asked = self._hair is None or maps is None or scene.changed or self._scenes % _BODY.person_every == 0
        hair = hair_odds(scene.rgb, person, known, head, self._scale, gain) if asked else _moved(self._hair, maps)
        self._hair, self._scenes = hair, self._scenes + 1
        oval = head.of_oval(scene.raster.shape)
        against = hair if output is None else hair + _network_against(output, scene.raster, oval)
        body_log_odds(scene.rgb, person, known, against, *self._tables, gain, _frame(head, own), _WEIGHTS, log_odds)
        by_rules = logistic(np.asarray(cv2.GaussianBlur(log_odds, (0, 0), _BODY.blur), np.float32))
        if asked:
            usual = gain_of(light)
            lit = relit(scene.rgb, usual)
            predicted = body_network.predict_body_skin(lit, person, known, head, usual * light, by_rules)
        else:
            predicted = _moved(self._predicted, maps)
        self._predicted = predicted
        beside = smoothstep(oval, *_NETWORK.rise)
        believed = np.where(person < 255 * _BODY.no_person, 0, _NETWORK.believed * beside)
        probability = fused(by_rules, predicted, np.asarray(believed, np.float32))
        of_face = face.alpha_at(xs, ys)
        _fill_gaps(probability, of_face, predicted, hair, head.size)
        _fill_holes(probability, of_face, head.size)
        share = _owned(scene, landmarks, head)
        if share is not None:
            probability = np.asarray(probability * share, np.float32)
        if self.color_trust < 1:
            probability *= np.float32(self.color_trust)
        leave_out_hair(probability, scene.rgb, person, known, hair, head, self._scale, gain)
        mask, alpha = self._smooth_in_time(scene, probability, known, person, head)
        return Matte.over(scene.raster.box, in_levels(alpha), mask)

    def _smooth_in_time(
        self, scene: Scene, probability: Floats, known: Floats, person: Bytes, head: HeadShape
    ) -> tuple[Bools, Floats]:
        """Mask and alpha (h, w), held to those of the scene before where nothing changed."""
        before, maps = self._before, scene.before
        if before is None or maps is None:
            mask = _parts(probability, probability > 0.5, known, person, None, head)
            alpha = soft_edge(probability, mask, _EDGE_BLUR)
        else:
            was_rgb, layers = before
            moved_rgb = cv2.remap(was_rgb, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            moved = cv2.remap(layers, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            was_probability, was, was_alpha = cv2.split(moved)
            # where a hand leaves a wall of the skin's brightness only the hue changes
            keep = weight_of_before(np.asarray(moved_rgb, np.uint8), scene.rgb)
            probability = (probability + keep * (was_probability - probability)).astype(np.float32)
            likely = probability + _TRACKING.hysteresis * keep * (was - 0.5) > 0.5
            mask = _parts(probability, likely, known, person, np.asarray(was, np.float32), head)
            alpha = soft_edge(probability, mask, _EDGE_BLUR)
            alpha = (alpha + keep * (was_alpha - alpha)).astype(np.float32)
        left = cv2.merge([probability, mask.astype(np.float32), alpha])
        self._before = scene.rgb, np.asarray(left, np.float32)
        return mask, alpha


def _network_against(output: NetworkOutput, raster: Raster, oval: Floats) -> Floats:
    """(h, w) nats that the network's output for the face's box counts against skin in the cells of a scene.

    It was taught hair, collars and walls; of hands, which come before the face, it knows nothing, so that it counts off
    the face's oval alone.  oval: (h, w), see `HeadShape.of_oval`.
    """
    off_face = smoothstep(oval, *_BODY.network_rise)
    return np.asarray(
        off_face * np.minimum(_BODY.network_weight * output.log_odds_against(raster), _BODY.network_most), np.float32
    )


def _fill_gaps(probability: Floats, face: Floats, predicted: Floats, hair: Floats, size: float) -> None:
    """Raise the probability (h, w), in place, where a hand on the face is cut by the end of the face's matte.

    Around the face nothing counts as the body's, and the face's matte ends with its box: what lies between both, is no
    hair and skin to the network is their hand's or neck's. All (h, w);  face: its matte in [0, 1];
    predicted: by the network;  hair: log-odds of hair, nats;  size: a face size in cells.
    """
    likely, of_face = (where.astype(np.uint8) for where in (probability > 0.5, face > _BODY.gap_face))
    side = 2 * max(1, round(_BODY.gap * size)) + 1
    either = likely | of_face
    closed = cv2.morphologyEx(either, cv2.MORPH_CLOSE, _square(side))
    gap = (closed > either) & (predicted > _BODY.gap_predicted) & (hair < _BODY.gap_hair)
    if not gap.any():
        return
    count, labels = cv2.connectedComponents(gap.astype(np.uint8), connectivity=8)
    beside = [cv2.dilate(one, _square(3)) > 0 for one in (likely, of_face)]
    between = np.all([np.bincount(labels[one], minlength=count) > 0 for one in beside], axis=0)
    between[0] = False
    np.copyto(probability, np.maximum(probability, predicted), where=between[labels])


def _fill_holes(probability: Floats, face: Floats, size: float) -> None:
    """Raise the probability (h, w), in place, in small holes of the person's skin: the inside of an ear is blood-red.

    face: (h, w) the face's matte in [0, 1];  size: a face size in cells.
    """
    skin = ((probability > 0.5) | (face > 0.5)).view(np.uint8)
    box = occupied(skin, 1)  # what reaches its edge reaches the picture's
    within = skin[box]
    if not within.size:
        return
    _, labels, stats, _ = cv2.connectedComponentsWithStats(1 - within, connectivity=4)
    x, y, w, h, area = stats.T
    rows, columns = within.shape
    holes = (area <= _BODY.hole * size**2) & (x > 0) & (y > 0) & (x + w < columns) & (y + h < rows)
    holes[0] = False
    if holes.any():
        part = probability[box]
        np.copyto(part, np.maximum(part, np.float32(_BODY.hole_probability)), where=holes[labels])


def leave_out_hair(
    probability: Floats,
    rgb: Bytes,
    person: Bytes,
    known: Floats,
    hair: Floats,
    head: HeadShape,
    scale: ColorScale,
    gain: Floats,
) -> None:
    """Set the probability (h, w) to 0, in place, in parts beside the face that are cut out of hair of one colour.

    The place of an ear makes up for a colour that is not quite the skin's. An ear ends where its colour does; a
    part whose surroundings have its own colour ends where that place does.  rgb, person, known, head, scale, gain: see
    `hair_odds`;  hair: (h, w) nats, its result.
    """
    y, x = (along.astype(np.float32) for along in np.ogrid[: known.shape[0], : known.shape[1]])
    down = head.axes.down
    above = (x - head.chin[0]) * down[0] + (y - head.chin[1]) * down[1] < -_BODY.hair_above * head.size
    likely, off_face = probability > 0.5, known < 0.5
    parts = (likely & off_face & above).view(np.uint8)
    rows, columns = occupied(parts)
    if not parts[rows, columns].size:
        return
    labels = np.zeros(parts.shape, np.int32)
    count, labels[rows, columns], stats, _ = cv2.connectedComponentsWithStats(parts[rows, columns], connectivity=8)
    stats[:, :2] += columns.start, rows.start
    around = off_face & ~likely & (person > 255 * _BODY.no_person)
    least, most = _BODY.hair_cells, _BODY.hair_most * head.size**2
    for part in range(1, count):
        x0, y0, w, h, area = (int(v) for v in stats[part])
        if not least <= area <= most:
            continue
        reach = _BODY.hair_reach
        box = slice(max(0, y0 - reach), y0 + h + reach), slice(max(0, x0 - reach), x0 + w + reach)
        inside = labels[box] == part
        mean_hair = float(hair[box][inside].mean())
        if mean_hair < _BODY.hair_least:
            continue
        near, far = (cv2.dilate(inside.astype(np.uint8), _square(2 * r + 1)) > 0 for r in (1, reach))
        ring = far & ~near & around[box]
        if int(ring.sum()) < least:
            continue
        lit = np.asarray(np.clip(np.rint(rgb[box] * gain), 0, 255), np.uint8)
        z = (to_skin_lab(lit) - scale.center) / scale.spread
        apart = np.median(z[inside], axis=0) - np.median(z[ring], axis=0)
        if float(np.linalg.norm(apart)) < _BODY.hair_alike + mean_hair:
            probability[box][inside] = 0.0


def _moved(values: Floats | None, maps: tuple[Floats, Floats] | None) -> Floats:
    """What was known of the scene before (h, w), where the cells were then."""
    if values is None or maps is None:
        raise ValueError("there is no scene before")
    return np.asarray(cv2.remap(values, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)


def _frame(head: HeadShape, landmarks: Landmarks) -> Floats:
    """The head as `body_log_odds` measures it."""
    ends = np.array(
        [
            head.size,
            head.width / 2 / head.size + _BODY.head_beside,
            head.height / 2 / head.size + _BODY.head_above,
            head.height / 2 / head.size + _BODY.head_below,
            head.width / 2 / head.size,
            ear_depth(head, landmarks),
        ],
        np.float32,
    )
    return np.concatenate([head.chin, head.neck, head.middle, head.axes.across, head.axes.down, ends]).astype(
        np.float32
    )


def _own_people(person: Bytes, known: Floats, size: float) -> Bytes:
    """The person mask (h, w) without small parts that have nothing of the face's own mask (h, w): pots and chairs.

    size: a face size in cells.
    """
    people, face, least = (person > 255 * _BODY.no_person).view(np.uint8), known > 0.5, _BODY.least_person * size**2
    large = people.size - int(np.count_nonzero(people)) > least  # what is nobody's, which is a part as well
    box = occupied(people) if large else (slice(None), slice(None))
    if not people[box].size:
        return person
    count, labels, stats, _ = cv2.connectedComponentsWithStats(people[box])
    kept = stats[:, cv2.CC_STAT_AREA] > least
    kept[0] |= large
    kept |= np.bincount(labels[face[box]], minlength=count) > 0
    if kept.all():
        return person
    out = person.copy()
    out[box] *= kept[labels]
    return out


def _owned(scene: Scene, landmarks: Landmarks, head: HeadShape) -> Floats | None:
    """(h, w) in [0, 1], how far each cell belongs to the person of this face rather than of others; None if alone.

    By what is nearer; who stands behind another one has nothing of that one's face.
    """
    middle, width = landmarks.axes.center, landmarks.axes.width
    others = [f for f in scene.faces if float(np.hypot(*(f.axes.center - middle))) > _SIDE_BY_SIDE * width]
    if not others:
        return None
    distance = _distance(scene.raster.shape, head)
    heads = [head_shape(f.in_cells(scene.raster)) for f in others]
    nearest = np.min([_distance(scene.raster.shape, other) for other in heads], axis=0)
    # both take what is as near to either: `place_body` divides it, and nothing is left to nobody
    share = np.minimum(2 / (1 + (distance / np.maximum(nearest, 1e-3)) ** _BODY.owner), 1)
    off_faces = np.min([other.of_oval(scene.raster.shape) for other in heads], axis=0)
    return np.asarray(share * smoothstep(off_faces, *_BODY.others_face), np.float32)


def _distance(shape: tuple[int, int], head: HeadShape) -> Floats:
    """(h, w) float32 distance from where the body below a head begins, or its middle if nearer, in face sizes."""
    y, x = np.ogrid[: shape[0], : shape[1]]
    begin = head.chin + _BODY.neck_end * head.size * head.neck
    ends = [np.hypot(x - at[0], y - at[1]) / head.size for at in (begin, head.middle)]
    return np.asarray(np.minimum(*ends), np.float32)


def _parts(
    probability: Floats, likely: Bools, known: Floats, person: Bytes, before: Floats | None, head: HeadShape
) -> Bools:
    """The parts of `likely` (h, w) that are a body's: what touches the face, and what is large and sure enough.

    Above the chin only a hand is skin that touches nothing, and a raised hand is large. Where the person mask is not
    sure, as on a floor of the skin's colour, what touches nothing must be surer by itself: a hand that comes in.
    known: (h, w) the face's own mask;  person: (h, w), 255 on people;  before: (h, w) the mask before;
    head: in cells.
    """
    size = head.size
    face = (known > 0.5).astype(np.uint8)
    joined = cv2.morphologyEx(likely.astype(np.uint8) | face, cv2.MORPH_CLOSE, _square(_BODY.join))
    whole: Bools = np.zeros(likely.shape, np.bool_)
    held = occupied(np.asarray(joined, np.uint8))
    if not joined[held].size:
        return whole
    count, labels, stats, middles = cv2.connectedComponentsWithStats(joined[held], connectivity=8)
    middles += held[1].start, held[0].start
    touching = cv2.dilate(face, _square(2 * _TOUCHING + 1))[held] > 0
    likely, probability, person = likely[held], probability[held], person[held]
    before = None if before is None else before[held]
    kept = np.bincount(labels[touching], minlength=count) > 0
    kept[0] = False
    for part in np.flatnonzero(~kept & (stats[:, cv2.CC_STAT_AREA] > _BODY.kept_part * size**2)):
        if part == 0:
            continue
        x, y, w, h = (int(v) for v in stats[part, :4])
        box = slice(y, y + h), slice(x, x + w)
        cells = likely[box] & (labels[box] == part)
        area = int(cells.sum())
        stood = before is not None and float((before[box][cells] > 0.5).mean() if area else 0) > _STOOD
        least = (_BODY.kept_part if stood else _BODY.least_part) * size**2
        if (middles[part] - head.chin) @ head.axes.down < 0:
            least *= _BODY.raised_part
        if area <= least:
            continue
        whose = float(person[box][cells].mean()) / 255
        sure = _BODY.sure if whose > (_BODY.kept_person if stood else _BODY.part_person) else _BODY.sure_alone
        kept[part] = float(probability[box][cells].mean()) > sure
    whole[held] = likely & kept[labels]
    return whole


def _square(side: int) -> Bytes:
    return np.ones((side, side), np.uint8)
