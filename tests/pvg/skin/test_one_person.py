"""Whose skin it is: the outline of one person of two, the parts that are another's, and the same in time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest

from pvg.face import Landmarks
from pvg.skin import BodyTracker, Scene, SceneReader, SkinTracker, fit_skin_model, one_person
from pvg.skin.one_person import UNSEEN, Known, OthersTracker, may_be_others, others_skin, outline_of
from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.prior import HeadShape, head_shape
from tests.conftest import Samples
from tests.gallery.faces import fit_widest, read_rgb
from tests.gallery.scenes import drawn_face

_OUTLINE = SKIN_PRIOR.outline
SHAPE = (180, 240)
ARM = np.s_[90:170, 10:40]  # 80 × 30 cells
KEEP = np.full(SHAPE, SKIN_PRIOR.tracking.keep, np.float32)


@dataclass(frozen=True, eq=False)
class Pair:
    """Two portraits beside each other: the picture, both faces, and the column where the other's begins."""

    rgb: np.ndarray
    faces: tuple[Landmarks, Landmarks]
    border: int

    def turned(self, degrees: float) -> Pair:
        """The same, turned about its middle."""
        h, w = self.rgb.shape[:2]
        matrix = cv2.getRotationMatrix2D(((w - 1) / 2, (h - 1) / 2), degrees, 1.0)
        rgb = cv2.warpAffine(self.rgb, matrix, (w, h), borderMode=cv2.BORDER_REPLICATE)

        def there(points: np.ndarray) -> np.ndarray:
            return (points @ matrix[:, :2].T + matrix[:, 2]).astype(np.float32)

        first, second = (Landmarks(there(face.points), there(face.skin_points)) for face in self.faces)
        return Pair(np.asarray(rgb, np.uint8), (first, second), self.border)


@pytest.fixture(scope="module")
def pair(samples: Samples) -> Pair:
    left, right = (read_rgb(getattr(samples, name)) for name in ("portrait", "dark_portrait"))
    own, other = fit_widest(left), fit_widest(right)
    ratio = own.axes.width / other.axes.width
    right = cv2.resize(right, None, fx=ratio, fy=ratio, interpolation=cv2.INTER_AREA)
    height = min(len(left), len(right))
    moved = other.scaled(np.full(2, ratio, np.float32)).moved(np.array([left.shape[1], 0], np.float32))
    return Pair(np.hstack([left[:height], right[:height]]), (own, moved), left.shape[1])


@pytest.fixture
def head() -> HeadShape:
    """20 cells a face size, at the top of the scene."""
    drawn = head_shape(drawn_face(width=120, center=(120, 50)).landmarks)
    scale = 20 / drawn.size
    return replace(drawn, width=drawn.width * scale, height=drawn.height * scale)


def _scene(**changes: object) -> Scene:
    rgb = np.random.default_rng(0).integers(90, 110, (540, 720, 3), np.uint8)
    reader = SceneReader()
    reader.step(rgb)
    return replace(reader.step(rgb), **changes)  # type: ignore[arg-type]


def _arm() -> np.ndarray:
    likely = np.zeros(SHAPE, np.bool_)
    likely[ARM] = True
    return likely


def _known(outline: float, answers: float = 1, others: float = 0) -> Known:
    return Known(*(np.full(SHAPE, value, np.float32) for value in (outline, answers, others)))


def _faces(pair: Pair, scene: Scene) -> list[np.ndarray]:
    return [head_shape(face.in_cells(scene.raster)).of_oval(scene.raster.shape) < 0.8 for face in pair.faces]


@pytest.mark.parametrize("turn", [0.0, 15.0, -15.0])
@pytest.mark.parametrize("who", [0, 1])
def test_one_person_of_two_is_outlined(pair: Pair, who: int, turn: float) -> None:
    """The square is turned with the head."""
    pair = pair.turned(turn)
    scene = SceneReader().step(pair.rgb, pair.faces)
    outline = outline_of(scene.rgb, head_shape(pair.faces[who].in_cells(scene.raster)))
    faces = _faces(pair, scene)
    assert outline is not None
    assert outline.shape == scene.raster.shape
    assert outline[faces[who]].mean() > 0.95
    assert outline[faces[1 - who]].mean() < 0.1


def test_of_a_face_that_it_does_not_see_nothing_is_said(pair: Pair) -> None:
    scene = SceneReader().step(np.full_like(pair.rgb, 127))
    assert outline_of(scene.rgb, head_shape(pair.faces[0].in_cells(scene.raster))) is None


def test_another_persons_skin_is_none_of_a_matte(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    """Somebody whose face nobody has found, for it is turned away or cut off: skin is all that there is of them."""
    own = pair.faces[0]
    model = fit_skin_model(pair.rgb, own)
    assert model.learned is not None
    scene = SceneReader().step(pair.rgb, (own,))
    skin = SkinTracker(model)
    face = skin.step(pair.rgb, own, scene)
    _, theirs = _faces(pair, scene)

    def taken() -> np.ndarray:
        body = BodyTracker(model.learned).step(scene, own, face, skin.light, skin.network_output)
        return body.alpha_at(*(np.asarray(v, np.float32) for v in scene.raster.centers()))

    after = taken()
    monkeypatch.setattr(one_person, "others_skin", lambda likely, *_: np.zeros_like(likely))
    before = taken()
    beside = np.arange(scene.raster.shape[1]) < pair.border / scene.raster.step - 2
    assert before[theirs].mean() > 0.3
    assert after[theirs].mean() < 0.02
    np.testing.assert_array_equal(after[:, beside], before[:, beside])


def test_it_is_worth_asking_only_where_skin_lies_apart(head: HeadShape) -> None:
    oval, arm = head.of_oval(SHAPE), _arm()
    assert may_be_others(arm, oval, head.size)
    assert not may_be_others(oval < _OUTLINE.away, oval, head.size)
    small = np.zeros_like(arm)
    small[100:104, 20:24] = True
    assert not may_be_others(small, oval, head.size)


@pytest.mark.parametrize(
    ("outline", "others", "expected"),
    [(0.1, 0, True), (0.35, 0, False), (0.35, 1, True), (0.45, 1, False), (0.9, 1, False)],
)
def test_a_part_is_anothers_as_a_whole_and_stays_so(
    outline: float, others: float, expected: bool, head: HeadShape
) -> None:
    found = others_skin(_arm(), _known(outline, 1, others), head.of_oval(SHAPE), head.size)
    assert found[ARM].all() == found[ARM].any() == expected


def test_a_limb_is_anothers_as_a_whole_however_unsure_the_outline_is_here_and_there(head: HeadShape) -> None:
    """Of two colours it would look worse than of one that is wrong."""
    known, oval = _known(0.05), head.of_oval(SHAPE)
    known.outline[90:110, 10:40] = 1  # a quarter of the arm
    assert others_skin(_arm(), known, oval, head.size)[ARM].all()
    known.outline[90:150, 10:40] = 1
    assert not others_skin(_arm(), known, oval, head.size).any()


def test_what_is_new_counts_as_this_persons_until_it_is_asked_for(head: HeadShape) -> None:
    oval = head.of_oval(SHAPE)
    assert not others_skin(_arm(), _known(0.0, answers=0), oval, head.size).any()
    assert others_skin(_arm(), _known(0.0, answers=0, others=1), oval, head.size)[ARM].all()


def test_the_face_and_small_parts_are_nobody_elses(head: HeadShape) -> None:
    oval = head.of_oval(SHAPE)
    assert not others_skin(oval < 1, _known(0.0), oval, head.size).any()
    small = np.zeros(SHAPE, np.bool_)
    small[100:106, 20:26] = True  # 36 of the 40 cells that a part has at least
    assert not others_skin(small, _known(0.0), oval, head.size).any()


def test_what_goes_on_beside_the_face_is_this_persons(head: HeadShape) -> None:
    """A neck under another's arm: one part, most of which is no skin of this person's."""
    oval, likely = head.of_oval(SHAPE), _arm()
    likely[int(head.middle[1]) : 110, 116:124] = True  # a neck that begins in the face
    likely[100:110, 40:124] = True
    known = _known(0.0)
    known.outline[:110, 110:130] = 1
    assert not others_skin(likely, known, oval, head.size).any()
    likely[100:110, 60:70] = False
    found = others_skin(likely, known, oval, head.size)
    assert found[ARM].all()
    assert not found[:, 116:].any()


@dataclass
class _Asked:
    """Stands for `outline_of`: how often it was asked, and what it says."""

    says: float | None = 0.0
    times: int = 0

    def __call__(self, *_: object) -> np.ndarray | None:
        self.times += 1
        return None if self.says is None else np.full(SHAPE, self.says, np.float32)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> _Asked:
    stand_in = _Asked()
    monkeypatch.setattr(one_person, "outline_of", stand_in)
    return stand_in


def test_one_person_alone_costs_no_network(head: HeadShape, asked: _Asked) -> None:
    tracker, oval = OthersTracker(), head.of_oval(SHAPE)
    for _ in range(20):
        assert not tracker.step(_scene(), oval < _OUTLINE.away, head, oval, KEEP).any()
    assert asked.times == 0


def test_a_wrong_answer_of_many_changes_nothing(head: HeadShape, asked: _Asked) -> None:
    tracker, oval, scene = OthersTracker(), head.of_oval(SHAPE), _scene()
    for step in range(6 * _OUTLINE.every):
        asked.says = 1.0 if step == 5 * _OUTLINE.every else 0.0
        assert tracker.step(scene, _arm(), head, oval, KEEP)[ARM].all(), step
    assert asked.times == 7  # after the first answer soon once more


@pytest.mark.parametrize("says", [None, UNSEEN])
def test_an_answer_that_says_nothing_changes_nothing(says: float | None, head: HeadShape, asked: _Asked) -> None:
    """A head that turns away for a while, and what lies beyond the network's square."""
    tracker, oval, scene = OthersTracker(), head.of_oval(SHAPE), _scene()
    assert tracker.step(scene, _arm(), head, oval, KEEP)[ARM].all()
    asked.says = says
    for step in range(8 * _OUTLINE.every):
        assert tracker.step(scene, _arm(), head, oval, KEEP)[ARM].all(), step
    assert asked.times > 8


@pytest.mark.parametrize("says", [None, UNSEEN])
def test_without_an_answer_nothing_is_anothers(says: float | None, head: HeadShape, asked: _Asked) -> None:
    asked.says = says
    tracker, oval, scene = OthersTracker(), head.of_oval(SHAPE), _scene()
    for _ in range(_OUTLINE.every):
        assert not tracker.step(scene, _arm(), head, oval, KEEP).any()
    assert asked.times == 1


def test_an_own_hand_in_the_place_of_anothers_comes_back(head: HeadShape, asked: _Asked) -> None:
    tracker, oval, scene = OthersTracker(), head.of_oval(SHAPE), _scene()
    for _ in range(6 * _OUTLINE.every):
        assert tracker.step(scene, _arm(), head, oval, KEEP)[ARM].all()
    asked.says, new = 1.0, np.zeros_like(KEEP)
    lost = [tracker.step(scene, _arm(), head, oval, new).any() for _ in range(4 * _OUTLINE.every)]
    assert sum(lost) <= 2 * _OUTLINE.every
    assert not any(lost[2 * _OUTLINE.every :])


def test_what_another_puts_in_is_asked_for_before_its_time(head: HeadShape, asked: _Asked) -> None:
    tracker, oval, scene, both = OthersTracker(), head.of_oval(SHAPE), _scene(), _arm()
    both[90:170, 200:230] = True
    new = KEEP.copy()
    new[:, 190:] = 0
    assert tracker.step(scene, _arm(), head, oval, KEEP)[ARM].all()
    for step in range(SKIN_PRIOR.body.person_every + 1):
        found = tracker.step(scene, both, head, oval, new)
        assert found[ARM].all()
        assert found[90:170, 200:230].all() == (step + 1 >= SKIN_PRIOR.body.person_every)
    assert asked.times == 2


@pytest.mark.parametrize("lost", [{"changed": True}, {"flow": None}])
def test_after_a_cut_it_is_asked_anew(lost: dict[str, object], head: HeadShape, asked: _Asked) -> None:
    tracker, oval = OthersTracker(), head.of_oval(SHAPE)
    assert tracker.step(_scene(), _arm(), head, oval, KEEP)[ARM].all()
    asked.says = 1.0
    assert not tracker.step(_scene(**lost), _arm(), head, oval, KEEP).any()
    assert asked.times == 2
