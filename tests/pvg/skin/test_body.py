"""All skin of a person: a drawn scene whose truth is known, and the person mask on real portraits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from pvg.face import Landmarks, layout
from pvg.raster import Raster
from pvg.skin import (
    BodyTracker,
    Matte,
    Scene,
    SceneReader,
    SkinTracker,
    body_network,
    fit_skin_model,
    one_person,
    person_mask,
    scene_raster,
)
from pvg.skin.body import _network_against
from pvg.skin.body_colors import color_tables
from pvg.skin.body_parts import beyond_box, body_parts, fill_gaps, fill_small_holes, leave_out_hair
from pvg.skin.color_model import ColorScale, SkinColors
from pvg.skin.face_in_scene import FaceInScene, own_people
from pvg.skin.network import NetworkOutput
from pvg.skin.one_person import OthersTracker
from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.prior import head_shape
from pvg.video import read_frames
from scripts.samples import Samples
from tests.gallery.faces import fit_widest, read_rgb
from tests.gallery.scenes import TONES, drawn_face, filled, shrunk

SIZE = (480, 640)
RED, OAK, PINE, HAIR = (170, 30, 35), (150, 102, 62), (196, 146, 104), (165, 112, 76)
SHADED_EAR, LIT_HAIR, DARK_HAIR = (132, 88, 51), (104, 66, 38), (72, 45, 24)
BLOOD, RIM, SHADED_HAIR = (150, 66, 64), (80, 17, 15), (86, 26, 16)


@pytest.fixture(autouse=True)
def _no_outline(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of drawn people the network that outlines one has nothing to say; test_one_person.py shows it real ones."""
    monkeypatch.setattr(one_person, "outline_of", lambda *_: None)


@dataclass(frozen=True, eq=False)
class Drawn:
    """A person before a wooden wall: the picture, the face, and where hand, cloth, wall and person are, (H, W) bool."""

    rgb: np.ndarray
    landmarks: Landmarks
    hand: np.ndarray
    cloth: np.ndarray
    wall: np.ndarray

    def scene(self, *others: Landmarks, reader: SceneReader | None = None) -> Scene:
        """The scene with a true person mask;  reader: that read the scene before."""
        seen = (reader or SceneReader()).step(self.rgb)
        h, w = seen.raster.shape
        person = cv2.resize((~self.wall).astype(np.uint8) * 255, (w, h), interpolation=cv2.INTER_AREA)
        return replace(seen, person=np.asarray(person, np.uint8), faces=(self.landmarks, *others))


def _drawn(tone: str = "tan", seed: int = 0, gain: float = 1.0, hand_at: tuple[float, float] = (470, 380)) -> Drawn:
    """A face and neck, a hand of the same skin, a red shirt, planks behind."""
    face = drawn_face((300, 150), 130, tone, SIZE, seed=seed)
    ys, xs = np.mgrid[: SIZE[0], : SIZE[1]]
    hand = np.hypot((xs - hand_at[0]) / 40, (ys - hand_at[1]) / 55) < 1
    shirt = filled(SIZE, np.array([[190, 300], [410, 300], [520, 479], [110, 479]])) & ~hand & ~face.skin
    wall = ~(face.skin | hand | shirt)
    rgb = face.rgb.astype(np.float32)
    noise = np.random.default_rng(seed).normal(0, 2, rgb.shape)
    planks = np.where(((xs // 40) % 2 > 0)[..., None], np.array(OAK, np.float32), np.array(PINE, np.float32))
    own = np.array(TONES[tone][0], np.float32)
    shade = (0.75 + 0.2 * np.clip((ys - 325) / 110, 0, 1))[..., None]
    for where, color in ((wall, planks), (shirt, np.array(RED, np.float32)), (hand, own * shade)):
        rgb[where] = np.broadcast_to(color, rgb.shape)[where] + noise[where]
    return Drawn(np.clip(rgb * gain, 0, 255).astype(np.uint8), face.landmarks, hand, shirt, wall)


def _alpha(drawn: Drawn, body: Matte) -> np.ndarray:
    xs, ys = (np.arange(n, dtype=np.float32) for n in SIZE[::-1])
    return body.alpha_at(xs, ys)


def _tracker(drawn: Drawn) -> tuple[BodyTracker, SkinTracker]:
    model = fit_skin_model(drawn.rgb, drawn.landmarks)
    assert model.learned is not None
    return BodyTracker(model.learned), SkinTracker(model)


def _step(body: BodyTracker, skin: SkinTracker, drawn: Drawn, scene: Scene) -> np.ndarray:
    matte = skin.step(drawn.rgb, drawn.landmarks)
    return _alpha(drawn, body.step(scene, drawn.landmarks, matte, skin.light))


def test_parts_are_told_what_was_kept_of_them_where_the_picture_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[np.ndarray | None] = []

    def looked_at(*given: Any) -> np.ndarray:
        seen.append(given[3])
        return body_parts(*given)

    monkeypatch.setattr("pvg.skin.body.body_parts", looked_at)
    drawn, reader = _drawn(), SceneReader()
    (body, skin), covered = _tracker(drawn), drawn.rgb.copy()
    covered[380:, 430:510] = 20
    scenes = [drawn.scene(reader=reader), drawn.scene(reader=reader), replace(drawn, rgb=covered).scene(reader=reader)]
    scenes[2:] = [replace(scenes[2], changed=False), replace(scenes[1], changed=True)]
    for scene in scenes:
        body.step(scene, drawn.landmarks, skin.step(drawn.rgb, drawn.landmarks), skin.light)
    first, same, half_covered, changed = seen
    assert first is None
    assert changed is None
    assert same is not None
    assert half_covered is not None
    rows, columns = (np.rint(v).astype(int) for v in scenes[0].raster.centers()[::-1])
    above, below = (
        np.ix_((rows > low) & (rows < high), (columns > 455) & (columns < 485))
        for low, high in ((345, 360), (400, 420))
    )
    assert same[above].min() > 0.9
    assert same[below].min() > 0.9
    assert half_covered[above].min() > 0.8
    assert half_covered[below].max() < 0.1


def test_the_network_speaks_against_what_hangs_beside_the_face_and_not_before_it() -> None:
    drawn = _drawn()
    scene = drawn.scene()
    head = head_shape(drawn.landmarks.in_cells(scene.raster))
    box = Raster.over(np.array([200, 20, 400, 330], np.float32), (155, 100))
    output = NetworkOutput(box, np.full(box.shape, 0.001, np.float32))
    oval = head.of_oval(scene.raster.shape)
    against = scene.raster.read(
        _network_against(output, scene.raster, oval), *(np.arange(n, dtype=np.float32) for n in SIZE[::-1])
    )
    assert against[150, 300] == 0  # the middle of the face: a hand may come before it
    assert against[300, 220] == pytest.approx(2.0, abs=0.01)  # below and beside the chin
    assert against[400, 470] == 0  # the hand, where nobody was asked
    likely = NetworkOutput(box, np.full(box.shape, 0.9, np.float32))
    assert not _network_against(likely, scene.raster, oval).any()


def test_an_own_arm_stays_where_another_persons_joins_it_to_the_face(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = _drawn()
    arm = np.zeros(SIZE, np.bool_)
    arm[290:330, 300:560] = True
    drawn.rgb[arm & ~drawn.hand] = np.median(drawn.rgb[drawn.hand], axis=0)
    scene = drawn.scene()
    scene.person[:] = 255
    _, columns = (np.rint(v).astype(int) for v in scene.raster.centers()[::-1])
    theirs = np.broadcast_to((columns > 400) & (columns < 440), scene.raster.shape)
    monkeypatch.setattr(OthersTracker, "step", lambda *_: theirs)
    # no part by itself is skin for sure
    monkeypatch.setattr("pvg.skin.body_parts._BODY", replace(SKIN_PRIOR.body, sure=1.1, sure_alone=1.1))
    body, skin = _tracker(drawn)
    alpha = _alpha(drawn, body.step(scene, drawn.landmarks, skin.step(drawn.rgb, drawn.landmarks), skin.light))
    assert alpha[300:320, 460:540].mean() > 0.9
    assert alpha[300:320, 410:430].mean() < 0.1


def test_hair_nearly_of_the_skins_colour_is_left_out_when_the_network_says_so() -> None:
    drawn = _drawn()
    lock = np.zeros(SIZE, np.uint8)
    cv2.rectangle(lock, (385, 200), (400, 300), 1, -1)
    lock = (lock > 0) & drawn.wall
    drawn.rgb[lock] = 0.55 * np.median(drawn.rgb[drawn.hand], axis=0) + 0.45 * np.array(HAIR)
    scene = drawn.scene()
    scene.person[:] = 255
    (body, skin), (other, _) = _tracker(drawn), _tracker(drawn)
    matte = skin.step(drawn.rgb, drawn.landmarks)
    box = Raster.over(np.array([200, 20, 410, 330], np.float32), (155, 105))
    output = NetworkOutput(box, np.full(box.shape, 0.001, np.float32))
    before, after = (
        _alpha(drawn, each.step(scene, drawn.landmarks, matte, skin.light, said))
        for each, said in ((body, None), (other, output))
    )
    assert before[lock].mean() > 0.15
    assert after[lock].mean() < 0.6 * before[lock].mean()
    assert after[drawn.hand].mean() > 0.98 * before[drawn.hand].mean()


@pytest.mark.parametrize("tone", ["pale", "tan", "dark"])
def test_a_hand_follows_and_cloth_and_wall_do_not(tone: str) -> None:
    drawn = _drawn(tone)
    alpha = _step(*_tracker(drawn), drawn, drawn.scene())
    assert alpha[shrunk(drawn.hand, 9)].mean() > 0.95
    assert alpha[shrunk(drawn.cloth, 9)].mean() < 0.01
    assert alpha[shrunk(drawn.wall, 9)].mean() < 0.01


@pytest.mark.parametrize(
    ("part_color", "around", "kept"),
    [
        (HAIR, HAIR, False),
        (HAIR, RED, True),
        (BLOOD, BLOOD, True),
        (SHADED_EAR, DARK_HAIR, True),
        (LIT_HAIR, DARK_HAIR, False),
    ],
    ids=[
        "hair",
        "an ear before something red",
        "an ear full of blood before a wall as red",
        "a brown ear before dark hair as brown",
        "a lit strand of dark hair",
    ],
)
def test_a_part_beside_the_face_ends_where_its_colour_does_or_is_hair(
    part_color: tuple[int, int, int], around: tuple[int, int, int], kept: bool
) -> None:
    drawn = _drawn()
    model = fit_skin_model(drawn.rgb, drawn.landmarks)
    assert model.learned is not None
    scene = drawn.scene()
    shape = scene.raster.shape
    probability, face_mask, hair = np.zeros((3, *shape), np.float32)
    hair += 3.0
    part = slice(20, 26), slice(20, 24)
    probability[part] = 0.9
    rgb = np.full((*shape, 3), around, np.uint8)
    rgb[part] = part_color
    head = head_shape(drawn.landmarks.in_cells(scene.raster))
    person = np.full(shape, 255, np.uint8)
    seen = FaceInScene(rgb, person, face_mask, head)
    leave_out_hair(probability, seen, hair, model.learned.colors.scale, np.ones(3, np.float32))
    assert (probability[part] > 0.5).all() == kept


def test_hair_of_nearly_the_skins_hue_is_none() -> None:
    drawn = _drawn()
    ys, xs = np.mgrid[: SIZE[0], : SIZE[1]]
    side, down = np.abs(xs - 300), ys - 140
    over = (np.hypot(side, np.minimum(down, 0)) < 105) & (ys < 330)  # over the head and down to the shoulders
    skin = _alpha(drawn, SkinTracker(fit_skin_model(drawn.rgb, drawn.landmarks)).step(drawn.rgb, drawn.landmarks)) > 0.5
    hair = over & ~skin
    rgb = drawn.rgb.copy()
    shine = np.random.default_rng(1).normal(1, 0.03, SIZE)[..., None]
    rgb[hair] = np.clip(np.array(HAIR) * shine, 0, 255)[hair].astype(np.uint8)
    person = Drawn(rgb, drawn.landmarks, drawn.hand, drawn.cloth & ~hair, drawn.wall & ~hair)
    alpha = _step(*_tracker(drawn), person, person.scene())  # the key frame has not seen it
    assert alpha[shrunk(hair, 9)].mean() < 0.15
    assert alpha[shrunk(person.hand, 9)].mean() > 0.95


def test_a_small_piece_of_wall_beside_the_head_is_none() -> None:
    drawn = _drawn()
    ys, xs = np.mgrid[: SIZE[0], : SIZE[1]]
    spot = np.hypot(xs - 450, ys - 70) < 17
    rgb = np.where(spot[..., None], np.array(TONES["tan"][0]) * 0.9, drawn.rgb).astype(np.uint8)
    person = Drawn(rgb, drawn.landmarks, drawn.hand, drawn.cloth, drawn.wall & ~spot)  # the person mask is wrong there
    alpha = _step(*_tracker(person), person, person.scene())
    assert alpha[spot].mean() < 0.02


@pytest.mark.parametrize(
    ("said", "hair", "below", "cloth", "filled"),
    [
        (0.9, 0.0, True, False, True),
        (0.6, 0.0, True, False, False),
        (0.9, 3.0, True, False, False),
        (0.9, 0.0, False, False, False),
        (0.9, 0.0, True, True, False),
    ],
    ids=["a hand on the face", "no skin to the network", "hair", "nothing beyond", "a collar"],
)
def test_a_gap_between_the_mattes_of_face_and_body_is_their_skin(
    said: float, hair: float, below: bool, cloth: bool, filled: bool
) -> None:
    probability, face = np.full((100, 60), 0.2, np.float32), np.zeros((100, 60), np.float32)
    face[:40] = 1
    if below:
        probability[52:, 20:40] = 0.95
    gap = slice(40, 52), slice(20, 40)
    rgb = np.full((100, 60, 3), (200, 150, 125), np.uint8)
    if cloth:
        rgb[gap] = (240, 236, 220)
    head = head_shape(drawn_face(width=70, center=(35, 35)).landmarks)
    seen = FaceInScene(rgb, np.full((100, 60), 255, np.uint8), face, head)
    by_network, against = np.full(face.shape, said, np.float32), np.full(face.shape, hair, np.float32)
    fill_gaps(probability, face, by_network, against, seen, np.ones(3, np.float32))
    assert (probability[gap] > 0.5).all() == (probability[gap] > 0.5).any() == filled
    assert probability[:40].max() < 0.5
    assert probability[40:, :10].max() < 0.5


@pytest.mark.parametrize(
    ("side", "at", "filled"),
    [(5, 30, True), (20, 30, False), (5, 0, False)],
    ids=["an ear's inside", "a wall behind an arm", "a corner of the picture"],
)
def test_what_little_a_persons_skin_encloses_is_skin(side: int, at: int, filled: bool) -> None:
    probability = np.full((80, 80), 0.8, np.float32)
    face = np.zeros_like(probability)
    probability[:, 40:], face[:, 40:] = 0.0, 1.0  # half of what is around is the face's own matte
    hole = slice(at, at + side), slice(at, at + side)
    probability[hole], face[hole] = 0.1, 0.0
    before = probability.copy()
    fill_small_holes(probability, face, 70.0)
    assert bool((probability[hole] > 0.5).all()) is filled
    probability[hole] = before[hole]
    np.testing.assert_array_equal(probability, before)


def _is_kept(rows: int, columns: int, probability: float, person: float, before: bool | None = None) -> bool:
    """Whether a part of so many cells in the last corner of a scene, away from the face, is all of a body's mask.

    before: whether it was in the scene before, None without one.
    """
    drawn = _drawn()
    scene = drawn.scene()
    head = head_shape(drawn.landmarks.in_cells(scene.raster))
    part = np.zeros(scene.raster.shape, bool)
    part[-rows:, -columns:] = True
    face_mask = np.zeros(part.shape, np.float32)
    face_mask[:10, :10] = 1
    cells, people = part * np.float32(probability), np.uint8(255 * person) * part.astype(np.uint8)
    was = None if before is None else part * np.float32(before)
    mask = body_parts(cells, part, FaceInScene(scene.rgb, people, face_mask, head), was)
    assert mask[part].all() == mask.any()
    return bool(mask.any())


@pytest.mark.parametrize(("probability", "person"), [(0.65, 0.9), (0.8, 0.6)], ids=["a hand", "not surely a person"])
def test_a_part_that_was_kept_may_be_less_likely_than_one_that_comes_in(probability: float, person: float) -> None:
    assert _is_kept(20, 20, probability, person, before=True)
    assert not _is_kept(20, 20, probability, person, before=False)
    assert not _is_kept(20, 20, probability, person)
    assert not _is_kept(20, 20, probability - 0.15, person, before=True)


@pytest.mark.parametrize(
    ("probability", "person", "kept"),
    [(0.8, 0.9, True), (0.8, 0.6, False), (0.93, 0.6, True)],
    ids=["a hand", "a floor that the person mask is not sure of", "a hand that comes in"],
)
def test_what_touches_nothing_is_a_persons_or_surely_skin(probability: float, person: float, kept: bool) -> None:
    assert _is_kept(30, 30, probability, person) is kept


def _box() -> tuple[Matte, Raster, np.ndarray]:
    """A matte of a face that its box cuts, the raster of a scene, and the mask in its cells."""
    raster = Raster.over(np.array([0, 0, 100, 80], np.float32), (80, 100))
    alpha = np.zeros((40, 40), np.uint8)
    alpha[10:, 10:] = 255
    face = Matte.over(np.array([20, 20, 60, 60], np.float32), alpha)
    return face, raster, face.raster.read(face.mask.astype(np.float32), *raster.centers())


@pytest.mark.parametrize(
    ("rows", "columns", "hair", "goes_on"),
    [
        (slice(35, 55), slice(50, 90), 0.0, True),
        (slice(35, 55), slice(50, 90), 3.0, False),
        (slice(35, 55), slice(70, 90), 0.0, False),
        (slice(2, 12), slice(35, 55), 0.0, False),
    ],
    ids=["a shoulder", "hair", "a hand apart", "above the mask"],
)
def test_the_end_of_a_faces_box_is_no_end_of_skin(rows: slice, columns: slice, hair: float, goes_on: bool) -> None:
    face, raster, face_mask = _box()
    by_rules = np.zeros(raster.shape, np.float32)
    by_rules[rows, columns] = 0.9
    shown = beyond_box(face, raster, face_mask, by_rules, np.full(raster.shape, hair, np.float32))
    outside = np.ones(raster.shape, bool)
    outside[20:60, 20:60] = False
    np.testing.assert_array_equal(shown[~outside], face_mask[~outside])
    beyond = outside & (by_rules > 0)
    assert (shown[beyond] == 1).all() if goes_on else not shown[beyond].any()
    assert not shown[outside & (by_rules == 0) & (face_mask == 0)].any()


def test_the_network_is_shown_skin_that_the_faces_box_cuts(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = _drawn()
    bare = drawn.cloth & (np.mgrid[: SIZE[0], : SIZE[1]][0] < 440)
    drawn.rgb[bare] = np.median(drawn.rgb[drawn.hand], axis=0)
    asked: list[np.ndarray] = []

    def network(seen: FaceInScene, light: np.ndarray, probability: np.ndarray) -> np.ndarray:
        asked.append(seen.face_mask)
        return probability

    monkeypatch.setattr(body_network, "predict_body_skin", network)
    body, skin = _tracker(drawn)
    scene = drawn.scene()
    matte = skin.step(drawn.rgb, drawn.landmarks)
    body.step(scene, drawn.landmarks, matte, skin.light)
    xs, ys = (np.asarray(v, np.float32) for v in scene.raster.centers())
    x0, y0, x1, y1 = matte.raster.box
    outside = ~(((ys > y0) & (ys < y1))[:, None] & (xs > x0) & (xs < x1))
    assert (asked[0][outside] > 0.5).sum() > 50


def test_a_shoulder_in_shade_is_skin_to_its_end(media_dir: Path) -> None:
    rgb = read_rgb(next((media_dir / "portraits").glob("woman_low_key_dark_background.*")))
    landmarks = fit_widest(rgb)
    model = fit_skin_model(rgb, landmarks)
    assert model.learned is not None
    scene, skin = SceneReader().step(rgb, (landmarks,)), SkinTracker(model)
    face = skin.step(rgb, landmarks, scene)
    body = BodyTracker(model.learned)
    matte = body.step(scene, landmarks, face, skin.light, skin.network_output)
    xs, ys = np.arange(730, 820, dtype=np.float32), np.arange(1025, 1175, dtype=np.float32)
    assert matte.alpha_at(xs, ys).mean() > 0.8


def test_light_that_changes_changes_no_matte() -> None:
    drawn, dim = _drawn(), _drawn(gain=0.6)
    trackers = _tracker(drawn)
    bright = _step(*trackers, drawn, drawn.scene())
    dark = _step(*trackers, dim, dim.scene())
    assert np.abs(bright - dark)[shrunk(drawn.hand, 9)].mean() < 0.02
    assert dark[shrunk(drawn.cloth, 9)].mean() < 0.01


def test_a_hand_that_moves_farther_than_the_flow_sees_is_found_at_once() -> None:
    drawn, after = _drawn(hand_at=(200, 420)), _drawn(hand_at=(420, 420))
    trackers, reader = _tracker(drawn), SceneReader()
    _step(*trackers, drawn, drawn.scene(reader=reader))
    scene = after.scene(reader=reader)
    assert scene.flow is not None
    assert scene.changed
    alpha = _step(*trackers, after, scene)
    assert alpha[shrunk(after.hand, 9)].mean() > 0.95
    assert alpha[drawn.hand & ~after.hand].mean() < 0.02


def _asked(monkeypatch: pytest.MonkeyPatch, first: Drawn, then: Drawn) -> tuple[np.ndarray, int]:
    """Alpha in the second of two scenes, whose flow explains the picture, and how often the network was asked."""
    asked: list[np.ndarray] = []

    def network(seen: FaceInScene, light: np.ndarray, probability: np.ndarray) -> np.ndarray:
        asked.append(probability)
        return probability

    monkeypatch.setattr(body_network, "predict_body_skin", network)
    trackers, reader = _tracker(first), SceneReader()
    _step(*trackers, first, first.scene(reader=reader))
    scene = then.scene(reader=reader)
    assert scene.flow is not None
    assert not scene.changed
    return _step(*trackers, then, scene), len(asked)


def test_fingers_that_come_in_are_too_little_of_the_picture_and_are_found_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    first, then = _drawn(hand_at=(300, 560)), _drawn(hand_at=(300, 510))
    alpha, asked = _asked(monkeypatch, first, then)
    fingers = shrunk(then.hand, 5)
    assert fingers.sum() > 800
    assert alpha[fingers].mean() > 0.85
    assert asked == 2


def test_a_hand_that_moves_a_little_needs_no_other_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    first, then = _drawn(hand_at=(470, 380)), _drawn(seed=1, hand_at=(475, 380))
    alpha, asked = _asked(monkeypatch, first, then)
    assert alpha[shrunk(then.hand, 9)].mean() > 0.95
    assert asked == 1


def test_noise_and_a_little_movement_are_no_change() -> None:
    reader = SceneReader()
    for seed, at in enumerate([470, 473, 477, 480]):
        assert not _drawn(seed=seed, hand_at=(at, 380)).scene(reader=reader).changed


def test_noise_does_not_move_the_matte_of_a_still() -> None:
    trackers = _tracker(_drawn())
    flow = None
    mattes = []
    for seed in range(8):
        drawn = _drawn(seed=seed)
        scene = replace(drawn.scene(), flow=flow)
        h, w = scene.raster.shape
        flow = np.zeros((h // 2, w // 2, 2), np.float32)
        mattes.append(_step(*trackers, drawn, scene))
    steps = [np.abs(b - a).mean() for a, b in pairwise(mattes[3:])]
    assert max(steps) < 1e-3


def test_a_hand_belongs_to_the_nearer_face() -> None:
    drawn = _drawn()
    at_hand = drawn.landmarks.moved(np.array([470, 300], np.float32) - drawn.landmarks.axes.center)
    trackers = _tracker(drawn)
    alpha = _step(*trackers, drawn, drawn.scene(at_hand))
    assert alpha[shrunk(drawn.hand, 9)].mean() < 0.05


def test_a_hand_between_two_people_is_not_left_to_nobody() -> None:
    drawn = _drawn()
    across = 2 * (470 - float(drawn.landmarks.axes.center[0])) + 60  # the hand lies nearly as near to both
    other = drawn.landmarks.moved(np.array([across, 0], np.float32))
    alpha = _step(*_tracker(drawn), drawn, drawn.scene(other))
    assert alpha[shrunk(drawn.hand, 9)].mean() > 0.8


@pytest.mark.parametrize("tone", [tone for tone in TONES if tone != "grey"])
@pytest.mark.parametrize(("share", "least", "most"), [(0.0, -np.inf, 0.0), (1.0, 2.0, np.inf)])
def test_what_has_hardly_any_chroma_is_no_skin(tone: str, share: float, least: float, most: float) -> None:
    drawn = _drawn(tone)
    colors = fit_skin_model(drawn.rgb, drawn.landmarks).learned.colors
    lab = colors.scale.center * np.array([1, share, share], np.float32)
    assert least < _odds(color_tables(colors)[0], lab) < most


def test_a_red_ear_is_skin_at_the_ears_only() -> None:
    drawn = _drawn()
    colors = fit_skin_model(drawn.rgb, drawn.landmarks).learned.colors
    everywhere, ears = color_tables(colors)
    red = colors.scale.center + np.array([-10, 14, 2], np.float32)
    assert _odds(everywhere, red) < 0 < _odds(ears, red)
    assert (ears >= everywhere - 1e-4).all()


def test_crimson_shade_is_an_ear_and_brown_shade_of_its_lightness_is_hair() -> None:
    drawn = _drawn()
    colors = fit_skin_model(drawn.rgb, drawn.landmarks).learned.colors
    _, ears = color_tables(colors)
    center, spread = colors.scale.center, colors.scale.spread
    tone = center[1:] / np.hypot(*center[1:])
    redder = np.array([tone[1], -tone[0]])  # across the hue
    dark = center[0] - 5 * spread[0]
    unit = spread[1:].mean()
    crimson, brown = (np.array([dark, *(center[1:] + (9 * tone + way * redder) * unit)], np.float32) for way in (4, -1))
    assert _odds(ears, brown) + 3 < _odds(ears, crimson)
    assert _odds(ears, crimson) > 2


def test_the_rim_of_an_ears_crimson_shade_is_an_ear_and_dark_hair_beside_it_is_none() -> None:
    scale = ColorScale(np.array([67.2, 17.3, 13.4], np.float32), np.array([9, 3.2, 3.2], np.float32))
    colors = SkinColors(scale, np.zeros(SKIN_PRIOR.colors.bins**3, np.float32))
    _, ears = color_tables(colors)
    rim, hair = (ears[tuple(np.rint(np.array(rgb) / 255 * (len(ears) - 1)).astype(int))] for rgb in (RIM, SHADED_HAIR))
    assert hair < 1
    assert rim > 3


def _odds(table: np.ndarray, lab: np.ndarray) -> float:
    """What a table of colours says of one, told as at the usual lightness."""
    color = lab.copy()
    color[1:] *= (max(color[0], 24.0) + 16) / 70
    rgb = cv2.cvtColor(color[None, None].astype(np.float32), cv2.COLOR_Lab2RGB)[0, 0]
    at = np.clip(np.rint(rgb * (table.shape[0] - 1)), 0, table.shape[0] - 1).astype(int)
    return float(table[tuple(at)])


def test_the_person_mask_covers_a_portrait_and_not_the_wall(samples: Samples) -> None:
    rgb = read_rgb(samples.pale_portrait)
    mask = person_mask(rgb)
    assert mask.shape == rgb.shape[:2]
    face = fit_widest(rgb)
    inside = filled(rgb.shape, cv2.convexHull(face.points[layout.CONTOUR])[:, 0])
    assert mask[inside].mean() > 0.97
    wide = np.concatenate([np.full_like(rgb, 128), rgb], axis=1)  # a wall beside the portrait
    beside = person_mask(wide)
    assert beside[:, : rgb.shape[1] * 3 // 4].mean() < 0.03
    assert beside[:, rgb.shape[1] :][inside].mean() > 0.9


def test_arms_that_the_sides_of_a_picture_cut_are_a_persons(media_dir: Path) -> None:
    clip = media_dir / "clips" / "man_stubble_warm_kitchen_audio_1080x1920.mp4"
    (frame,) = read_frames(clip, start=75, stop=76)
    mask = person_mask(cv2.resize(frame.rgb(), (270, 480), interpolation=cv2.INTER_AREA))
    for arm in (mask[380:430, :15], mask[380:430, -15:]):
        assert arm.mean() > 0.9


def test_a_scene_covers_the_picture_with_square_cells() -> None:
    for size in ((1080, 1920), (479, 641), (64, 64)):
        raster = scene_raster(size)
        assert raster.box[2] == pytest.approx(size[1])
        assert size[0] <= raster.box[3] + 1e-3 < size[0] + raster.step + 1e-3
        assert max(raster.shape) <= 257


def test_skin_without_colour_tells_of_no_other_skin() -> None:
    drawn = _drawn("grey")
    grey = replace(drawn, rgb=np.repeat(drawn.rgb.mean(axis=2, keepdims=True), 3, axis=2).astype(np.uint8))
    body, skin = _tracker(grey)
    assert body.color_trust == 0.0
    assert not _step(body, skin, grey, grey.scene()).any()
    colored, _ = _tracker(_drawn())
    assert colored.color_trust == 1.0


@pytest.mark.parametrize("crowded", [False, True])
def test_small_parts_without_a_face_are_no_people_wherever_the_others_are(crowded: bool) -> None:
    """Also where people fill the picture, and what is nobody's is a small part itself."""
    person, face_mask = np.full((60, 80), 255 if crowded else 3, np.uint8), np.zeros((60, 80), np.float32)
    person[5:8, 70:75] = 3 if crowded else 255  # a pot, or a gap
    if not crowded:
        person[20:60, 10:60] = 200
        person[2:4, 2:4] = 130  # of a face that is known
        face_mask[3, 3] = 1
    found = own_people(person, face_mask, 20.0)
    kept = person.copy()
    kept[5:8, 70:75] = 0
    np.testing.assert_array_equal(found, kept)
    assert person.max() == 255  # what it was given is as it was
