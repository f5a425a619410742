"""All skin of a person: a drawn scene whose truth is known, and the person mask on real portraits."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
import pytest

from pvg.face import Landmarks, layout
from pvg.skin import BodyTracker, Matte, Scene, SceneReader, SkinTracker, fit_skin_model, person_mask, scene_raster
from scripts.samples import Samples
from tests.gallery.faces import fit_widest, read_rgb
from tests.gallery.scenes import TONES, drawn_face, filled, shrunk

SIZE = (480, 640)
RED, OAK, PINE, HAIR = (170, 30, 35), (150, 102, 62), (196, 146, 104), (165, 112, 76)


@dataclass(frozen=True, eq=False)
class Drawn:
    """A person before a wooden wall: the picture, the face, and where hand, cloth, wall and person are, (H, W) bool."""

    rgb: np.ndarray
    landmarks: Landmarks
    hand: np.ndarray
    cloth: np.ndarray
    wall: np.ndarray

    def scene(self, *others: Landmarks) -> Scene:
        """The scene with a true person mask."""
        seen = SceneReader().step(self.rgb)
        h, w = seen.raster.shape
        person = cv2.resize((~self.wall).astype(np.uint8) * 255, (w, h), interpolation=cv2.INTER_AREA)
        return Scene(seen.raster, seen.rgb, np.asarray(person, np.uint8), None, (self.landmarks, *others))


def _drawn(tone: str = "tan", seed: int = 0, gain: float = 1.0) -> Drawn:
    """A face and neck, a hand of the same skin, a red shirt, planks behind."""
    face = drawn_face((300, 150), 130, tone, SIZE, seed=seed)
    ys, xs = np.mgrid[: SIZE[0], : SIZE[1]]
    hand = np.hypot((xs - 470) / 40, (ys - 380) / 55) < 1
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
    return BodyTracker(model.learned.colors, model.learned.light), SkinTracker(model)


def _step(body: BodyTracker, skin: SkinTracker, drawn: Drawn, scene: Scene) -> np.ndarray:
    matte = skin.step(drawn.rgb, drawn.landmarks)
    return _alpha(drawn, body.step(scene, drawn.landmarks, matte, skin.light))


@pytest.mark.parametrize("tone", ["pale", "tan", "dark"])
def test_a_hand_follows_and_cloth_and_wall_do_not(tone: str) -> None:
    drawn = _drawn(tone)
    alpha = _step(*_tracker(drawn), drawn, drawn.scene())
    assert alpha[shrunk(drawn.hand, 9)].mean() > 0.95
    assert alpha[shrunk(drawn.cloth, 9)].mean() < 0.01
    assert alpha[shrunk(drawn.wall, 9)].mean() < 0.01


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


def test_light_that_changes_changes_no_matte() -> None:
    drawn, dim = _drawn(), _drawn(gain=0.6)
    trackers = _tracker(drawn)
    bright = _step(*trackers, drawn, drawn.scene())
    dark = _step(*trackers, dim, dim.scene())
    assert np.abs(bright - dark)[shrunk(drawn.hand, 9)].mean() < 0.02
    assert dark[shrunk(drawn.cloth, 9)].mean() < 0.01


def test_noise_does_not_move_the_matte_of_a_still() -> None:
    trackers = _tracker(_drawn())
    flow = None
    mattes = []
    for seed in range(8):
        drawn = _drawn(seed=seed)
        scene = drawn.scene()
        scene = Scene(scene.raster, scene.rgb, scene.person, flow, scene.faces)
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


def test_a_scene_covers_the_picture_with_square_cells() -> None:
    for size in ((1080, 1920), (479, 641), (64, 64)):
        raster = scene_raster(size)
        assert raster.box[2] == pytest.approx(size[1])
        assert size[0] <= raster.box[3] + 1e-3 < size[0] + raster.step + 1e-3
        assert max(raster.shape) <= 257
