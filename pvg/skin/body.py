"""The rest of a person's skin: neck, chest, arms and hands, told in the whole picture by what the face taught.

In every cell of a scene the log-odds add up: how alike its colour is to the face's own, its hue more than its light;
what the key frame saw of that colour beside the face; the person mask; evenness; against what lies around the head,
which is hair or the face's; and for what the face's own mask calls neck. Two networks have their say off the face's
oval, for hair, cloth and walls of the skin's colour. What is likely skin then counts where it touches the face or makes
a part that is surely skin, and is made steady in time as the face's matte is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Floats, smoothstep
from pvg.face import Landmarks
from pvg.raster import Raster, block
from pvg.skin import body_network
from pvg.skin._kernels import BodyWeights, body_log_odds
from pvg.skin.body_colors import color_tables
from pvg.skin.body_parts import beyond_box, body_parts, fill_gaps, fill_small_holes, leave_out_hair
from pvg.skin.collar import collar
from pvg.skin.face_in_scene import FaceInScene
from pvg.skin.highlights import fill_highlights
from pvg.skin.in_time import SkinInTime, held, in_levels, moved, moved_layers, weight_of_before
from pvg.skin.learning import LearnedSkin
from pvg.skin.light import gain_back, gain_of, relit
from pvg.skin.matte import Matte
from pvg.skin.network import NetworkOutput, fused
from pvg.skin.one_person import OthersTracker
from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.prior import HeadShape, ear_depth, head_shape, logistic
from pvg.skin.ring import hair_odds
from pvg.skin.scene import Scene

_BODY, _NETWORK = SKIN_PRIOR.body, SKIN_PRIOR.body_network
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
    neck=np.float32(_BODY.neck),
    neck_begins=np.float32(_BODY.neck_rise[0]),
    neck_ends=np.float32(_BODY.neck_rise[1]),
    most=np.float32(_BODY.most),
)
_SIDE_BY_SIDE = 0.5  # of a face's width: faces nearer to each other are one
_KEEP = SKIN_PRIOR.tracking.keep
_EDGE_BLUR = 1.0  # cells around the mask's edge


@dataclass(frozen=True, eq=False)
class _Asked:
    """What costs much and is asked for in some scenes only, between them it moves with the picture: (h, w) float32.

    hair: nats against skin, see `hair_odds`;  predicted, by_rules: the probability of skin by the networks, and by the
    rules when they were asked.
    """

    hair: Floats
    predicted: Floats
    by_rules: Floats


class BodyTracker:
    """Makes the matte of a person's skin off the face in each scene of a track, in order."""

    def __init__(self, learned: LearnedSkin) -> None:
        """learned: on the face's key frame.

        Sets `color_trust`: in [0, 1], how far there is chroma enough around the face to find other skin by.
        """
        self._tables = color_tables(learned.colors)
        self._scale = learned.colors.scale
        self._light = learned.light
        self.color_trust = float(smoothstep(np.array(learned.chroma), *_BODY.color_trust))
        # what one scene leaves to the next: its picture (h, w, 3) and skin, and what was asked
        self._before: tuple[Bytes, SkinInTime] | None = None
        self._asked: _Asked | None = None
        self._scenes = 0
        self._others = OthersTracker()

    def step(
        self, scene: Scene, landmarks: Landmarks, face: Matte, light: Floats, output: NetworkOutput | None = None
    ) -> Matte:
        """The matte in the next scene, over the whole picture.

        landmarks: of the face, source pixels;  face: its own matte;  light: (3,) RGB, its colour now;
        output: the network's for the face's box.
        """
        own = landmarks.in_cells(scene.raster)
        head = head_shape(own)
        seen = FaceInScene.of(scene, face, head)
        gain, usual = gain_back(self._light, light), gain_of(light)
        lit = relit(scene.rgb, usual)
        oval = head.of_oval(scene.raster.shape)

        beside = np.float32(0) if output is None else _network_against(output, scene.raster, oval)
        ears = ear_depth(head, own)
        asked = self._asked_before(scene)
        if asked is not None:
            by_rules = self._by_rules(seen, asked.hair + beside, gain, ears)
            if _other_skin(asked.by_rules, by_rules, head):
                asked = None
        if asked is None:
            hair = hair_odds(seen, self._scale, gain)
            by_rules = self._by_rules(seen, hair + beside, gain, ears)
            shown = beyond_box(face, scene.raster, seen.face_mask, by_rules, hair)
            usually = replace(seen, rgb=lit, face_mask=shown)
            predicted = body_network.predict_body_skin(usually, usual * light, by_rules)
            asked = _Asked(hair, predicted, by_rules)
        self._asked = asked

        probability = fused(by_rules, asked.predicted, _believed(seen, oval))
        of_face = face.alpha_at(*(np.asarray(v, np.float32) for v in scene.raster.centers()))
        fill_gaps(probability, of_face, asked.predicted, asked.hair, seen, gain)
        fill_small_holes(probability, of_face, head.size)
        fill_highlights(probability, of_face, seen, self._scale, gain)
        share = _owned(scene, landmarks, head)
        if share is not None:
            probability = np.asarray(probability * share, np.float32)
        before = self._skin_before(scene)
        keep = None if before is None else before[1]
        others = self._others.step(scene, probability > 0.5, head, oval, keep)
        if self.color_trust < 1:
            probability *= np.float32(self.color_trust)
        leave_out_hair(probability, seen, asked.hair, self._scale, gain)
        probability *= 1 - collar(lit, np.maximum(probability, of_face), head)

        kept = None if before is None or scene.changed else before[0].mask * before[1] / np.float32(_KEEP)

        def parts(probability: Floats, likely: Bools) -> Bools:
            # another's limb may join this person's own to the face
            return body_parts(np.where(others, with_others, probability), likely | others, seen, kept) & ~others

        with_others, probability = probability, np.where(others, np.float32(0), probability)
        mask, skin = held(probability, before, parts, _EDGE_BLUR)
        self._before = scene.rgb, skin
        # the picture decides within the edge as it is drawn; where it does not say, the cells' steps would be seen
        soft = cv2.GaussianBlur(skin.alpha, (0, 0), _BODY.edge_soft)
        return Matte.over(scene.raster.box, in_levels(np.asarray(soft, np.float32)), mask)

    def _asked_before(self, scene: Scene) -> _Asked | None:
        """What was asked in a scene before, where its cells are now; None in a scene in which it is asked anew."""
        before, maps, due = self._asked, scene.before, self._scenes % _BODY.person_every == 0
        self._scenes += 1
        if before is None or maps is None or scene.changed or due:
            return None
        return _Asked(*moved_layers([before.hair, before.predicted, before.by_rules], maps))

    def _by_rules(self, seen: FaceInScene, against: Floats, gain: Floats, ears: float) -> Floats:
        """Probability of skin (h, w) by colour and place.

        against: (h, w) nats for what lies around the head;  gain: (3,) to the key frame's light;  ears: their depth.
        """
        log_odds = np.empty(against.shape, np.float32)
        frame = _head_frame(seen.head, ears)
        body_log_odds(seen.rgb, seen.person, seen.face_mask, against, *self._tables, gain, frame, _WEIGHTS, log_odds)
        return logistic(np.asarray(cv2.GaussianBlur(log_odds, (0, 0), _BODY.blur), np.float32))

    def _skin_before(self, scene: Scene) -> tuple[SkinInTime, Floats] | None:
        """The skin of the scene before where its cells are now, and its weight (h, w); None without one."""
        if self._before is None or scene.before is None:
            return None
        rgb, skin = self._before
        # in colour: where a hand leaves a wall of the skin's brightness only the hue changes
        keep = weight_of_before(moved(rgb, scene.before), scene.rgb)
        return SkinInTime(*moved_layers(skin.layers, scene.before)), keep


def _other_skin(then: Floats, now: Floats, head: HeadShape) -> bool:
    """Whether the rules see skin, or none, where they did not: what the networks said then does not know of it.

    A hand that comes in fast is too little of the picture for `Scene.changed`.
    then, now: (h, w) probability by the rules, `then` moved to where its cells are now.
    """
    off = np.asarray(np.abs(now - then) > 0.5, np.bool_).view(np.uint8)
    broad = cv2.erode(off, block(2))
    return bool(cv2.countNonZero(broad) > _BODY.other * head.size**2)


def _believed(seen: FaceInScene, oval: Floats) -> Floats:
    """(h, w) in [0, 1], the networks' weight: none where nobody is, and none in the face.  oval: see `of_oval`."""
    beside = smoothstep(oval, *_NETWORK.rise)
    return np.asarray(np.where(seen.person < 255 * _BODY.no_person, 0, _NETWORK.believed * beside), np.float32)


def _network_against(output: NetworkOutput, raster: Raster, oval: Floats) -> Floats:
    """(h, w) nats that the network's output for the face's box counts against skin in the cells of a scene.

    It was taught hair, collars and walls; of hands, which come before the face, it knows nothing, so that it counts off
    the face's oval alone.  oval: (h, w), see `HeadShape.of_oval`.
    """
    off_face = smoothstep(oval, *_BODY.network_rise)
    return np.asarray(
        off_face * np.minimum(_BODY.network_weight * output.log_odds_against(raster), _BODY.network_most), np.float32
    )


def _head_frame(head: HeadShape, ears: float) -> Floats:
    """(16,) float32, the head as `body_log_odds` measures it; what stands where is said there.  ears: their depth."""
    half_width, half_height = head.width / 2 / head.size, head.height / 2 / head.size
    around = half_width + _BODY.head_beside, half_height + _BODY.head_above, half_height + _BODY.head_below
    ends = np.array([head.size, *around, half_width, ears], np.float32)
    places = (head.chin, head.neck, head.middle, head.axes.across, head.axes.down)
    return np.concatenate([*places, ends]).astype(np.float32)


def _owned(scene: Scene, landmarks: Landmarks, head: HeadShape) -> Floats | None:
    """(h, w) in [0, 1], how far each cell belongs to the person of this face rather than of others; None if alone."""
    middle, width = landmarks.axes.center, landmarks.axes.width
    others = [f for f in scene.faces if float(np.hypot(*(f.axes.center - middle))) > _SIDE_BY_SIDE * width]
    if not others:
        return None
    distance = _distance(scene.raster.shape, head)
    heads = [head_shape(f.in_cells(scene.raster)) for f in others]
    nearest = np.min([_distance(scene.raster.shape, other) for other in heads], axis=0)
    # both take what is as near to either: `place_body` divides it, and nothing is left to nobody by this
    return np.asarray(np.minimum(2 / (1 + (distance / np.maximum(nearest, 1e-3)) ** _BODY.owner), 1), np.float32)


def _distance(shape: tuple[int, int], head: HeadShape) -> Floats:
    """(h, w) float32 distance from where the body below a head begins, or its middle if nearer, in face sizes."""
    y, x = np.ogrid[: shape[0], : shape[1]]
    begin = head.chin + _BODY.neck_end * head.size * head.neck
    ends = [np.hypot(x - at[0], y - at[1]) / head.size for at in (begin, head.middle)]
    return np.asarray(np.minimum(*ends), np.float32)
