"""What a mouth's outline shows: lips, and skin before an open mouth."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from pvg.asset import FaceInFrame, KeyFrame
from pvg.face import PARTS, layout
from pvg.membrane import Lattice
from pvg.rendering.mouth import see_mouth
from pvg.video import RGB24, PixelFormat
from tests.gallery.assets import key_frame
from tests.gallery.pictures import YUV444, frame_of
from tests.gallery.scenes import filled, with_cloth

SKIN, LIPS, PALE_LIPS = (190.0, 150.0, 130.0), (160.0, 95.0, 95.0), (150.0, 118.0, 108.0)
HAND = (168.0, 131.0, 112.0)  # in its own shade
LATTICE = Lattice.over((0, 0, 640, 360))


def key_of(lips: tuple[float, float, float]) -> KeyFrame:
    parts = np.tile(np.array(SKIN, np.float32), (len(PARTS), 1))
    parts[PARTS.index("lips")] = lips
    differs = np.random.default_rng(0).normal(0, 4, (32, 3))  # as skin does
    skin = (np.array(SKIN) + np.vstack([differs, -differs])).astype(np.float32)
    return replace(key_frame(), skin=skin, parts=parts)


def mouth(face: FaceInFrame, lips: tuple[float, float, float], light: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """A face of skin with lips, its picture (360, 640, 3), and where the middle of the outline is on the nodes."""
    picture = np.full((360, 640, 3), SKIN)
    outline = face.landmarks.points[layout.LIPS_OUTER]
    drawn = np.zeros((360, 640), np.uint8)
    cv2.fillPoly(drawn, [np.rint(outline).astype(np.int32)], 1)
    picture[drawn > 0] = lips
    inner = cv2.erode(drawn, np.ones((5, 5), np.uint8))
    at = np.arange(LATTICE.height) * LATTICE.step, np.arange(LATTICE.width) * LATTICE.step
    ys, xs = (np.minimum(np.rint(side).astype(int), most - 1) for side, most in zip(at, (360, 640), strict=True))
    return light * picture, inner[np.ix_(ys, xs)] > 0


@pytest.mark.parametrize("pixel_format", [YUV444, RGB24], ids=["clip", "still"])
@pytest.mark.parametrize("lips", [LIPS, PALE_LIPS])
@pytest.mark.parametrize("light", [1.0, 0.8, 1.15])
def test_lips_are_shown_in_any_light(
    face: FaceInFrame, pixel_format: PixelFormat, lips: tuple[float, float, float], light: float
) -> None:
    picture, within = mouth(face, lips, light)
    shown = see_mouth(frame_of(picture, pixel_format), face.landmarks, key_of(lips), LATTICE).lips
    assert shown is not None
    assert shown[within].min() > 0.9


@pytest.mark.parametrize("lips", [LIPS, PALE_LIPS, None])
def test_light_from_one_side_hides_no_half_of_the_lips(
    face: FaceInFrame, lips: tuple[float, float, float] | None
) -> None:
    """Lips on the lit side are as bright as skin on the other one; skin over the mouth is still no lip."""
    picture, within = mouth(face, lips or SKIN)
    outline = face.landmarks.points[layout.LIPS_OUTER]
    across = (np.arange(640) - outline[:, 0].mean()) / np.ptp(outline[:, 0])
    picture *= np.exp(-0.5 * np.clip(across, -1, 1))[:, None]
    shown = see_mouth(frame_of(picture, YUV444), face.landmarks, key_of(lips or PALE_LIPS), LATTICE).lips
    assert shown is not None
    if lips:
        assert shown[within].min() > 0.85
    else:
        assert shown[within].max() < 0.1


@pytest.mark.parametrize("pixel_format", [YUV444, RGB24], ids=["clip", "still"])
@pytest.mark.parametrize("lips", [LIPS, PALE_LIPS])
def test_a_finger_over_the_mouth_is_no_lip(
    face: FaceInFrame, pixel_format: PixelFormat, lips: tuple[float, float, float]
) -> None:
    picture, within = mouth(face, SKIN)
    shown = see_mouth(frame_of(picture, pixel_format), face.landmarks, key_of(lips), LATTICE).lips
    assert shown is not None
    assert shown[within].max() < 0.05


@pytest.mark.parametrize("cloth", [(150, 195, 225), (32, 32, 36), (235, 236, 238), (215, 185, 160)])
@pytest.mark.parametrize("lips", [LIPS, PALE_LIPS])
def test_a_mask_of_cloth_shows_neither_lips_nor_teeth(
    face: FaceInFrame, lips: tuple[float, float, float], cloth: tuple[int, int, int]
) -> None:
    """It is put on after the key frame, which showed the lips."""
    picture, within = mouth(face, lips)
    masked = with_cloth(picture, face.landmarks, cloth)
    seen = see_mouth(frame_of(masked, YUV444), face.landmarks, key_of(lips), LATTICE)
    assert seen.lips is not None
    assert seen.lips[within].max() < 0.05
    assert seen.skin is not None
    assert seen.skin[within].min() > 0.95


@pytest.mark.parametrize("behind", [SKIN, HAND])
def test_a_key_frame_with_a_hand_before_the_mouth_shows_no_lips(
    face: FaceInFrame, behind: tuple[float, float, float]
) -> None:
    picture, _ = mouth(face, behind)
    shown = see_mouth(frame_of(picture, YUV444), face.landmarks, key_of(behind), LATTICE).lips
    assert shown is not None
    assert not shown.any()


@pytest.mark.parametrize("lips", [LIPS, PALE_LIPS])
def test_lips_of_a_faded_picture_are_shown(face: FaceInFrame, lips: tuple[float, float, float]) -> None:
    def faded(colors: np.ndarray) -> np.ndarray:
        return np.asarray(0.5 * colors + 100, colors.dtype)

    picture, within = mouth(face, lips)
    key = key_of(lips)
    key = replace(key, skin=faded(key.skin), parts=faded(key.parts))
    shown = see_mouth(frame_of(faded(picture), YUV444), face.landmarks, key, LATTICE).lips
    assert shown is not None
    assert shown[within].min() > 0.9


def test_lips_that_the_key_frame_did_not_see_are_not_told(face: FaceInFrame) -> None:
    picture, _ = mouth(face, LIPS)
    assert see_mouth(frame_of(picture, YUV444), face.landmarks, key_of((np.nan,) * 3), LATTICE).lips is None


TEETH = (205.0, 198.0, 190.0)


def opened(face: FaceInFrame) -> FaceInFrame:
    """The face with its mouth open by a fifth of its width."""
    points = face.landmarks.points.copy()
    down = 0.2 * face.landmarks.axes.width * face.landmarks.axes.down
    points[[*range(91, 96), *range(101, 104)]] += down.astype(np.float32)  # the lower lip's outlines
    return replace(face, landmarks=replace(face.landmarks, points=points))


def open_mouth(face: FaceInFrame, finger: bool) -> np.ndarray:
    """Its picture (360, 640, 3): lips, teeth between them, and a finger across both."""
    picture, _ = mouth(face, LIPS)
    for outline, color in ((layout.LIPS_OUTER, LIPS), (layout.LIPS_INNER, TEETH)):
        picture[filled(picture.shape, face.landmarks.points[outline])] = color
    if finger:
        middle, width = face.landmarks.points[layout.LIPS_INNER].mean(axis=0), face.landmarks.axes.width
        picture[:, int(middle[0] - 0.06 * width) : int(middle[0] + 0.06 * width)] = SKIN
    return picture


@pytest.mark.parametrize("pixel_format", [YUV444, RGB24], ids=["clip", "still"])
def test_a_finger_before_an_open_mouth_is_skin_and_teeth_are_none(face: FaceInFrame, pixel_format: PixelFormat) -> None:
    wide = opened(face)
    middle = wide.landmarks.points[layout.LIPS_INNER].mean(axis=0)
    x, y = np.rint((middle - [LATTICE.x, LATTICE.y]) / LATTICE.step).astype(int)
    aside = round(0.12 * wide.landmarks.axes.width / LATTICE.step)
    seen = see_mouth(frame_of(open_mouth(wide, True), pixel_format), wide.landmarks, key_of(LIPS), LATTICE).skin
    assert seen is not None
    assert seen[y, x] > 0.9
    assert seen[y, x - aside] < 0.1
    assert (
        see_mouth(frame_of(open_mouth(wide, False), pixel_format), wide.landmarks, key_of(LIPS), LATTICE).skin is None
    )


def test_a_shut_mouth_shows_no_fingers(face: FaceInFrame) -> None:
    points = face.landmarks.points.copy()
    points[layout.LIPS_INNER] = points[layout.LIPS_INNER].mean(axis=0)
    shut, (picture, _) = replace(face.landmarks, points=points), mouth(face, SKIN)
    assert see_mouth(frame_of(picture, YUV444), shut, key_of(LIPS), LATTICE).skin is None


def test_no_finger_is_told_from_lips_that_are_the_skin_but_darker(face: FaceInFrame) -> None:
    wide, dark = opened(face), tuple(0.75 * channel for channel in SKIN)
    picture = open_mouth(wide, True)
    seen = see_mouth(frame_of(picture, YUV444), wide.landmarks, key_of((dark[0], dark[1], dark[2])), LATTICE)
    assert seen.lips is not None
    assert seen.skin is None


@pytest.mark.parametrize(("lit", "whole"), [(0.3, True), (0.85, False)], ids=["light", "a hand"])
def test_lips_that_are_the_skin_but_darker_keep_the_part_that_is_lit(
    face: FaceInFrame, lit: float, whole: bool
) -> None:
    dark = (0.75 * SKIN[0], 0.75 * SKIN[1], 0.75 * SKIN[2])
    picture, within = mouth(face, dark)
    outline = face.landmarks.points[layout.LIPS_OUTER]
    edge = int(outline[:, 0].min() + lit * np.ptp(outline[:, 0]))
    picture[:, :edge] = SKIN
    shown = see_mouth(frame_of(picture, YUV444), face.landmarks, key_of(dark), LATTICE).lips
    assert shown is not None
    bright = within & (np.arange(LATTICE.width) * LATTICE.step < edge - 20)[None]
    assert bright.any()
    assert (shown[bright].min() > 0.9) if whole else (shown[bright].max() < 0.1)
