"""What is coloured as no skin is, letters and stickers, stays as it is."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

import pvg
from pvg._arrays import Bytes, Doubles, Floats
from pvg.asset import FaceInFrame, FaceRecord
from pvg.face import layout
from pvg.looks import LookMap, SkinMap
from pvg.looks.exposure import at_exposure
from pvg.rendering import Renderer, foreign, source_frame
from pvg.rendering.coding import Coding
from pvg.rendering.correction import at_curves
from pvg.rendering.foreign import own_tables, skin_of, without_foreign
from pvg.rendering.map_tables import MapTables
from pvg.rendering.placed_face import PlacedFace
from pvg.video import RGB24, RGB48, Frame, PixelFormat
from pvg.video.color import named_space
from tests.gallery.pictures import FORMATS, YUV422_10, frame_of

SKIN = np.array([190.0, 140.0, 115.0])
YELLOW, RED, BLUE = (255.0, 212.0, 0.0), (224.0, 40.0, 42.0), (40.0, 90.0, 230.0)
ONCE = np.ones((1, 5), np.float32)
OTHER_CODES = [
    replace(one, name=f"{one.name} {name}", color=named_space(name))
    for name in ("vlog", "logc4", "pq", "hlg")
    for one in (YUV422_10, RGB48)
]


def _tables(pixel_format: PixelFormat) -> MapTables:
    light = np.random.default_rng(0).uniform(0.7, 1.2, (300, 1))
    own = (SKIN * light).astype(np.float32)
    return MapTables.of(LookMap(SkinMap.between(own, 0.8 * own.astype(float)), 1.0, ONCE), pixel_format)


def _told(pixel_format: PixelFormat, *colors: tuple[float, float, float], lips: bool = False) -> Doubles:
    tables = _tables(pixel_format)
    codes = Coding(pixel_format).colors(np.array(colors, np.float32)) + tables.offset
    where = np.ones((len(colors), 1), np.bool_)
    return tables.foreign(np.ascontiguousarray(codes.T[:, :, None], np.float32), where, where & lips)[:, 0]


@pytest.fixture(scope="module")
def placed(placed: PlacedFace) -> PlacedFace:
    """A face whose matte takes everything in its window."""
    return replace(placed, alpha=np.ones_like(placed.alpha))


@pytest.mark.parametrize("pixel_format", [*FORMATS, *OTHER_CODES], ids=lambda f: f.name)
def test_plain_colours_are_told_from_skin_and_grey(pixel_format: PixelFormat) -> None:
    skin = (tuple(SKIN), (95, 70, 58), (215, 120, 110), (205, 110, 100), (150, 142, 158))  # blush, an ear, blue shade
    np.testing.assert_array_equal(_told(pixel_format, *skin, (235, 235, 235), (20, 20, 20), (128, 128, 128)), 0)  # type: ignore[arg-type]
    assert _told(pixel_format, YELLOW, RED, BLUE).min() > 0.7  # 1 but for red in HDR


def test_lips_may_be_painted_in_any_red() -> None:
    np.testing.assert_array_equal(_told(RGB24, RED, (180, 20, 60), lips=True), 0)
    np.testing.assert_array_equal(_told(RGB24, YELLOW, BLUE, lips=True), 1)


def test_for_painted_lips_the_skin_around_is_not_looked_at(placed: PlacedFace, monkeypatch: pytest.MonkeyPatch) -> None:
    """Most faces with red lips are looked at closely; all that is dear in it waits for something that is no lips."""
    marks, lips = placed.data.landmarks, np.zeros((360, 640), np.uint8)
    cv2.fillPoly(lips, [np.rint(marks.points[layout.LIPS_OUTER]).astype(np.int32)], 1)
    looked: list[foreign._Window] = []
    around = foreign._Window._around

    def seen(window: foreign._Window) -> Floats:
        looked.append(window)
        return around(window)

    monkeypatch.setattr(foreign._Window, "_around", seen)
    tables, corner = _tables(YUV422_10), (placed.x, placed.y)
    frame = frame_of(np.where(lips[..., None] > 0, np.array(RED), SKIN), YUV422_10)
    assert foreign._Window(frame, corner, placed.alpha, tables, marks, 2).may_be_foreign
    assert without_foreign(frame, corner, placed.alpha, tables, marks) is placed.alpha
    assert not looked


def _lettered(placed: PlacedFace) -> tuple[Doubles, tuple[slice, slice]]:
    """A picture of skin with a yellow bar across the forehead, and where its inside is."""
    center = placed.data.landmarks.axes.center.astype(int)
    picture = np.tile(SKIN, (360, 640, 1))
    y, x = center[1] - 60, center[0]
    picture[y - 8 : y + 8, x - 30 : x + 30] = YELLOW
    return picture, (slice(y - 6, y + 6), slice(x - 28, x + 28))


@pytest.mark.parametrize("pixel_format", [*FORMATS, RGB24], ids=lambda f: f.name)
def test_letters_are_taken_out_of_the_matte_and_nothing_else(placed: PlacedFace, pixel_format: PixelFormat) -> None:
    picture, (rows, columns) = _lettered(placed)
    corner, marks = (placed.x, placed.y), placed.data.landmarks
    left = without_foreign(frame_of(picture, pixel_format), corner, placed.alpha, _tables(pixel_format), marks)
    ys, xs = (slice(s.start - at, s.stop - at) for s, at in ((rows, placed.y), (columns, placed.x)))
    assert left[ys, xs].max() == pytest.approx(0.0, abs=1e-5)
    beside = left.copy()
    beside[ys.start - 9 : ys.stop + 9, xs.start - 9 : xs.stop + 9] = 1
    np.testing.assert_array_equal(beside, 1)
    plain = frame_of(np.tile(SKIN, (360, 640, 1)), pixel_format)
    assert without_foreign(plain, corner, placed.alpha, _tables(pixel_format), marks) is placed.alpha


@pytest.mark.parametrize("pixel_format", [*FORMATS, RGB24], ids=lambda f: f.name)
@pytest.mark.parametrize("stroke", [2, 3])
def test_thin_letters_do_not_blink_while_the_face_moves_under_them(
    placed: PlacedFace, pixel_format: PixelFormat, stroke: int
) -> None:
    """Wherever a frame's window begins, the same is told of a caption that stays in its place."""
    word, (x, y) = np.zeros((360, 640), np.uint8), placed.data.landmarks.axes.center.astype(int)
    cv2.putText(word, "HOLD", (x - 60, y - 50), cv2.FONT_HERSHEY_SIMPLEX, 0.8, 255, stroke, cv2.LINE_8)
    picture = np.where(word[..., None] > 0, np.array(YELLOW), SKIN)
    frame, marks, tables = frame_of(picture, pixel_format), placed.data.landmarks, _tables(pixel_format)
    left = []
    for shift in np.arange(0, 16, 2 ** max(pixel_format.chroma_log2)):
        alpha = placed.alpha[:, shift:]
        part = word[placed.y :, placed.x + shift :][: alpha.shape[0], : alpha.shape[1]]
        corner = int(placed.x + shift), placed.y
        left.append(without_foreign(frame, corner, alpha, tables, marks)[part > 0].mean())
    assert max(left) < 0.5
    assert np.ptp(left) < 0.05


def test_in_the_light_of_two_lamps_colours_must_be_farther_off(placed: PlacedFace) -> None:
    light = np.random.default_rng(0).uniform(0.7, 1.2, (300, 1))
    warm, blue = (np.asarray(SKIN * lamp * light, np.float32) for lamp in ((1.1, 1.0, 0.9), (0.5, 0.8, 1.6)))
    one, two = (own_tables(skin, RGB24) for skin in (warm, np.concatenate([warm, blue])))
    assert one.farther == 1.0
    assert two.farther > 1.3
    codes = (Coding(RGB24).colors(np.concatenate([warm, blue])) + two.offset).T[:, :, None]
    assert not two.foreign(np.ascontiguousarray(codes), np.ones(codes.shape[1:], np.bool_)).any()


def test_along_the_end_of_the_matte_nothing_is_told(placed: PlacedFace) -> None:
    """Skin mixes there with a green wall, and `edges` has told how much of it is skin."""
    alpha = placed.alpha.copy()
    alpha[:, :100] = 0
    picture = np.tile(SKIN, (360, 640, 1))
    picture[:, : placed.x + 103] = (60.0, 160.0, 90.0)
    corner, marks = (placed.x, placed.y), placed.data.landmarks
    assert without_foreign(frame_of(picture, RGB24), corner, alpha, _tables(RGB24), marks) is alpha


def test_light_of_another_colour_is_no_paint(placed: PlacedFace) -> None:
    """It goes over softly, as far as it may go."""
    center = placed.data.landmarks.axes.center
    y, x = np.mgrid[:360, :640]
    spot = np.exp(-((x - center[0]) ** 2 + (y - center[1] + 30) ** 2) / 50.0**2)[..., None]
    lit = SKIN * (1 - spot * (1 - np.array([0.4, 0.7, 1.5])))
    tables, corner, marks = _tables(RGB24), (placed.x, placed.y), placed.data.landmarks
    peak = Coding(RGB24).colors((SKIN * np.array([0.4, 0.7, 1.5]))[None].astype(np.float32))
    assert tables.foreign((peak + tables.offset).T[:, :, None], np.ones((1, 1), np.bool_)) == 1  # taken by itself
    left = without_foreign(frame_of(lit, RGB24), corner, placed.alpha, tables, marks)
    assert left.min() > 0.8
    assert (left < 1).mean() < 0.01


@pytest.mark.parametrize(("width", "is_skin"), [(15.0, True), (0.5, False)], ids=["two lamps", "paint"])
def test_half_a_face_under_another_lamp_is_skin_where_the_light_goes_over(
    placed: PlacedFace, width: float, *, is_skin: bool
) -> None:
    below = (np.arange(360)[:, None, None] - placed.data.landmarks.axes.center[1] - 20) / width
    lamp = SKIN * (1 - (1 - np.array([0.3, 0.7, 1.9])) / (1 + np.exp(-np.clip(below, -50, 50))))
    frame, corner, marks = frame_of(lamp * np.ones((1, 640, 1)), RGB24), (placed.x, placed.y), placed.data.landmarks
    left = without_foreign(frame, corner, placed.alpha, _tables(RGB24), marks)
    assert (left is placed.alpha) is is_skin


def test_a_clip_that_turns_from_grey_to_colour_shows_skin_in_both(placed: PlacedFace) -> None:
    """The key frame is a grey one."""
    shading = 1 + 0.1 * np.sin(np.arange(640) / 15.0)[None, :, None]
    grey = (np.full((300, 3), 150.0) * np.random.default_rng(0).uniform(0.7, 1.2, (300, 1))).astype(np.float32)
    tables = MapTables.of(LookMap(SkinMap.between(grey, 0.8 * grey.astype(float)), 1.0, ONCE), RGB24)
    for share in (0.2, 0.6, 1.0):
        picture = (150 + share * (SKIN - 150)) * shading * np.ones((360, 1, 1))
        frame, marks = frame_of(picture, RGB24), placed.data.landmarks
        assert without_foreign(frame, (placed.x, placed.y), placed.alpha, tables, marks) is placed.alpha


def test_a_fit_through_letters_asks_for_nothing() -> None:
    tables = _tables(RGB24)
    g = np.tile(Coding(RGB24).colors(SKIN[None].astype(np.float32)), (60, 1))
    g[30] = Coding(RGB24).colors(np.array([[225.0, 60.0, 60.0]], np.float32))[0]
    new = g + tables.gained(g) + np.float32(9.0)
    shift = at_curves(g, new.astype(np.float32), tables).shift
    np.testing.assert_allclose(shift[25:36], 0.0, atol=1e-4)
    np.testing.assert_allclose(np.delete(shift, range(25, 36), axis=0), 9.0, atol=1e-3)


def test_a_face_that_shows_no_skin_is_left_as_it_is(video: pvg.VectorVideo) -> None:
    record: FaceRecord = video.records[0]
    bare = [replace(key, skin=key.skin[:0], skin_at=key.skin_at[:0]) for key in record.key_frames]
    assert skin_of(replace(record, key_frames=tuple(bare)), 20) is None


def _with_bar(frame: Frame, face: FaceInFrame) -> tuple[Frame, tuple[slice, slice]]:
    """The frame with a yellow bar below the eyes, and the pixels of the bar's inside."""
    nose = face.landmarks.points[layout.NOSE_TIP].astype(int)
    rgb: Bytes = frame.rgb().copy()
    y, x = int(nose[1]) - 14, int(nose[0])
    rgb[y - 6 : y + 6, x - 40 : x + 40] = YELLOW
    planes = frame.format.from_rgb(rgb)
    return replace(frame, planes=planes), (slice(y - 3, y + 3), slice(x - 36, x + 36))


def test_letters_over_a_face_keep_their_colour(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> None:
    renderer = Renderer(video, [pvg.transfer(video, dark_reference)])
    face = video.face_at(0, 20)
    assert face is not None
    plain = source_frame(video, 20)
    lettered, bar = _with_bar(plain, face)
    drawn, without = (renderer.draw(frame)[0].rgb().astype(int) for frame in (lettered, plain))
    assert np.abs(without - plain.rgb())[bar].mean() > 5  # the skin there takes the look
    assert np.abs(drawn - lettered.rgb())[bar].max() <= 2


def test_letters_are_told_beside_the_skin_under_the_lamp_of_their_frame(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Under a red lamp, as in the beginning of this clip, skin has all that yellow is away from it otherwise."""
    record: FaceRecord = video.records[0]
    (key,) = record.key_frames
    red = at_exposure(key, np.array([1.2, 0.3, 0.1]))
    lit = replace(record, key_frames=(replace(red, frame=2), replace(key, frame=8, since=7)))
    monkeypatch.setattr(video, "records", (lit, *video.records[1:]))
    renderer = Renderer(video, [pvg.transfer(video, dark_reference)])
    face = video.face_at(0, 20)
    assert face is not None
    lettered, bar = _with_bar(source_frame(video, 20), face)
    assert np.abs(renderer.draw(lettered)[0].rgb().astype(int) - lettered.rgb())[bar].max() <= 2
