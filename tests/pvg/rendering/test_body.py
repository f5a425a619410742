"""All skin of a person, drawn: what changes, what does not, and where the face's matte and the body's meet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest

import pvg
from pvg.asset import FaceInFrame
from pvg.curves import table_labels
from pvg.face import layout
from pvg.looks import LookMap, Region, SkinMap
from pvg.rendering import Renderer, source_frame
from pvg.rendering.body import apply_body
from pvg.rendering.foreground import foreground
from pvg.rendering.map_tables import MapTables
from pvg.rendering.neck import without_chest
from pvg.rendering.placed_body import PlacedBody, place_body
from pvg.rendering.placed_face import PlacedFace, place_face
from pvg.skin import Matte
from pvg.video import RGB24, Frame, PixelFormat
from tests.gallery.scenes import shrunk

_ONCE = np.ones((1, 5), np.float32)  # one key frame, the one that the map was made from

FORMATS = [
    PixelFormat("yuv420p", 8, (1, 1), (0.299, 0.114), False),
    PixelFormat("yuv420p10le", 10, (1, 1), (0.2126, 0.0722), False),
    PixelFormat("yuv444p", 8, (0, 0), (0.2126, 0.0722), True),
    RGB24,
]
SIZE = (96, 128)


def _skin(rng: np.random.Generator, middle: tuple[int, int, int] = (190, 140, 110)) -> np.ndarray:
    light = rng.uniform(0.6, 1.2, (400, 1))
    return np.clip(np.array(middle) * light + rng.normal(0, 3, (400, 3)), 1, 254).astype(np.float32)


def _frame(pixel_format: PixelFormat) -> Frame:
    """A disc of skin, shaded, on blue."""
    x = np.arange(SIZE[1])
    shade = np.broadcast_to(0.7 + 0.3 * x / SIZE[1], SIZE)
    rgb = np.where(_disc()[..., None], np.array([190, 140, 110]) * shade[..., None], np.array([60, 80, 150]))
    return Frame(0, 0, 0.0, pixel_format, pixel_format.from_rgb(rgb))


def _disc() -> np.ndarray:
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    return np.hypot(x - 60, y - 50) < 30


def _matte(cell: int = 4) -> Matte:
    coarse = _disc().reshape(SIZE[0] // cell, cell, SIZE[1] // cell, cell).mean(axis=(1, 3))
    return Matte.over(np.array([0, 0, SIZE[1], SIZE[0]], np.float32), np.rint(255 * coarse).astype(np.uint8))


def _drawn(frame: Frame, look: LookMap, region: Region = "face") -> Frame:
    (body,) = place_body(frame, _matte(), [], [])
    shown = foreground(frame, (body.x, body.y), body.alpha, body.step)
    return frame.patched(apply_body(frame, body, shown, MapTables.of(look, frame.format, region=region)))


def _alpha(bodies: list[PlacedBody], shape: tuple[int, int]) -> np.ndarray:
    """Over the whole frame."""
    alpha = np.zeros(shape, np.float32)
    for body in bodies:
        h, w = body.alpha.shape
        alpha[body.y : body.y + h, body.x : body.x + w] += body.alpha
    return alpha


def _to(middle: tuple[int, int, int]) -> SkinMap:
    rng = np.random.default_rng(3)
    return SkinMap.between(_skin(rng), _skin(rng, middle).astype(np.float64))


@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda f: f.name)
def test_own_colours_change_no_bit(pixel_format: PixelFormat) -> None:
    skin = _skin(np.random.default_rng(0))
    frame = _frame(pixel_format)
    drawn = _drawn(frame, LookMap(SkinMap.between(skin, skin.astype(np.float64)), 1.0, _ONCE))
    for before, after in zip(frame.planes, drawn.planes, strict=True):
        np.testing.assert_array_equal(before, after)


@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda f: f.name)
@pytest.mark.parametrize("goal", [(235, 195, 175), (90, 60, 45)])
def test_skin_goes_where_the_map_says_and_the_rest_keeps_its_bits(
    pixel_format: PixelFormat, goal: tuple[int, int, int]
) -> None:
    frame, skin = _frame(pixel_format), _to(goal)
    drawn = _drawn(frame, LookMap(skin, 1.0, _ONCE))
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    inside, outside = np.hypot(x - 60, y - 50) < 20, np.hypot(x - 60, y - 50) > 60
    wanted = skin(frame.rgb()[inside].astype(np.float32))
    assert np.abs(drawn.rgb()[inside] - wanted).mean() < 6  # luma rolls off, chroma by BT.709's luma
    np.testing.assert_array_equal(drawn.rgb()[outside], frame.rgb()[outside])


def _redness(rgb: np.ndarray) -> np.ndarray:
    return np.asarray(rgb[..., 0] - rgb.astype(float) @ [0.299, 0.587, 0.114])


@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda f: f.name)
@pytest.mark.parametrize(("goal", "most"), [((205, 175, 155), 0.25), ((190, 140, 110), 1.05)], ids=["paler", "own"])
def test_a_crimson_ear_comes_near_to_a_face_of_another_hue_and_stays_beside_its_own(
    pixel_format: PixelFormat, goal: tuple[int, int, int], most: float
) -> None:
    ear = np.hypot(*(np.mgrid[: SIZE[0], : SIZE[1]] - np.array([50, 60])[:, None, None])) < 14
    skin, crimson = np.array([190.0, 140.0, 110.0]), np.array([215.0, 130.0, 110.0])
    rgb = np.where(ear[..., None], crimson, np.where(_disc()[..., None], skin, np.array([60.0, 80.0, 150.0])))
    frame = Frame(0, 0, 0.0, pixel_format, pixel_format.from_rgb(rgb))
    drawn = _drawn(frame, LookMap(_to(goal), 1.0, _ONCE), "beside")
    within, beside = shrunk(ear, 4), shrunk(_disc() & ~ear, 4)
    before, after = (
        _redness(each.rgb())[within].mean() - _redness(each.rgb())[beside].mean() for each in (frame, drawn)
    )
    assert before > 20
    assert most - 0.2 < after / before < most
    assert np.ptp(_redness(drawn.rgb())[within]) < 4


def test_the_deep_red_hollow_of_an_ear_does_not_turn_grey() -> None:
    """In deep shade what sets an ear apart stays as k has it."""
    skin, hollow = np.array([190.0, 140.0, 110.0]), np.array([85.0, 35.0, 35.0])
    dark = np.hypot(*(np.mgrid[: SIZE[0], : SIZE[1]] - np.array([50, 60])[:, None, None])) < 14
    rgb = np.where(dark[..., None], hollow, np.where(_disc()[..., None], skin, np.array([60.0, 80.0, 150.0])))
    frame = Frame(0, 0, 0.0, FORMATS[0], FORMATS[0].from_rgb(rgb))
    look = LookMap(_to((205, 175, 155)), 1.0, _ONCE)
    drawn = _drawn(frame, look, "beside")
    free = replace(MapTables.of(look, frame.format, region="beside"), bound=np.zeros(256, np.float32))
    (body,) = place_body(frame, _matte(), [], [])
    shown = foreground(frame, (body.x, body.y), body.alpha, body.step)
    unbounded = frame.patched(apply_body(frame, body, shown, free))
    within = shrunk(dark, 4)
    assert _redness(drawn.rgb())[within].mean() > 0.95 * _redness(unbounded.rgb())[within].mean()


def test_the_edge_lies_where_the_picture_has_it() -> None:
    """The matte's cells are 4 pixels, its edge is the luma's."""
    alpha = _alpha(place_body(_frame(FORMATS[0]), _matte(), [], []), SIZE)
    assert np.abs(alpha - _disc()).mean() < 0.02
    xs, ys = np.arange(SIZE[1], dtype=np.float32), np.arange(SIZE[0], dtype=np.float32)
    assert np.abs(alpha - _disc()).mean() < 0.7 * np.abs(_matte().alpha_at(xs, ys) - _disc()).mean()


def test_half_the_strength_goes_half_the_way() -> None:
    frame, skin = _frame(FORMATS[0]), _to((90, 60, 45))
    whole, half = (_drawn(frame, LookMap(skin, strength, _ONCE)).planes[0].astype(int) for strength in (1.0, 0.5))
    assert np.abs((whole - frame.planes[0]) / 2 - (half - frame.planes[0].astype(int))).max() <= 1


def test_hands_far_apart_are_drawn_apart_and_as_they_would_be_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two discs at the ends of a wide frame: two windows, and the alpha of one window over both."""
    disc = _disc()
    wide = np.concatenate([disc, np.zeros((SIZE[0], 400), bool), disc[:, ::-1]], axis=1)
    rgb = np.where(wide[..., None], np.array([190, 140, 110]), np.array([60, 80, 150]))
    frame = Frame(0, 0, 0.0, FORMATS[0], FORMATS[0].from_rgb(rgb))
    coarse = wide.reshape(SIZE[0] // 4, 4, -1, 4).mean(axis=(1, 3))
    matte = Matte.over(np.array([0, 0, wide.shape[1], SIZE[0]], np.float32), np.rint(255 * coarse).astype(np.uint8))
    monkeypatch.setattr("pvg.rendering.placed_body._WORTH", 0.0)
    apart = place_body(frame, matte, [], [])
    monkeypatch.setattr("pvg.rendering.placed_body._WORTH", 1e9)
    together = place_body(frame, matte, [], [])
    assert (len(apart), len(together)) == (2, 1)
    assert sum(body.alpha.size for body in apart) < 0.5 * together[0].alpha.size
    np.testing.assert_allclose(_alpha(apart, wide.shape), _alpha(together, wide.shape), atol=1e-6)


def test_a_matte_of_many_specks_is_drawn_as_one() -> None:
    """Of an asset that somebody made, or of noise: each joins the next, and none ends the drawing."""
    specks = np.zeros((480, 480), np.uint8)
    for offset in (8, 9):
        specks[8::16, offset::16] = specks[9::16, offset::16] = 255
    matte = Matte.over(np.array([0, 0, 960, 960], np.float32), specks)
    grey = np.full((960, 960), 128, np.uint8)
    (body,) = place_body(Frame(0, 0, 0.0, RGB24, (grey, grey, grey)), matte, [], [])
    assert body.alpha.max() > 0.5


def _placed(video: pvg.VectorVideo, face: FaceInFrame) -> tuple[Frame, PlacedFace, np.ndarray]:
    """A frame, the face where it is there, and its alpha over the whole frame."""
    frame = source_frame(video, 20)
    placed = place_face(face, table_labels(), frame.width, frame.height)
    assert placed is not None
    own = np.zeros((frame.height, frame.width), np.float32)
    x0, y0, x1, y1 = placed.window
    own[y0:y1, x0:x1] = placed.alpha
    return frame, placed, own


def _on_grey(matte: np.ndarray, cell: int, faces: Sequence[PlacedFace]) -> np.ndarray:
    """A body's matte (H, W), known in cells of so many pixels, beside faces in a picture with nothing to follow."""
    h, w = matte.shape
    coarse = matte.reshape(h // cell, cell, -1, cell).mean(axis=(1, 3))
    body = Matte.over(np.array([0, 0, w, h], np.float32), np.rint(255 * coarse).astype(np.uint8))
    grey = np.full(matte.shape, 128, np.uint8)
    return _alpha(place_body(Frame(0, 0, 0.0, RGB24, (grey, grey, grey)), body, faces, []), matte.shape)


def test_face_and_body_meet_without_a_gap(video: pvg.VectorVideo, face: FaceInFrame) -> None:
    """Both together are at most their sum, and the larger of both within skin: no edge and no gap lies between them."""
    frame, placed, own = _placed(video, face)
    alone, beside = (_alpha(place_body(frame, face.body, faces, []), own.shape) for faces in ([], [placed]))
    both = beside + own
    # a tenth of a level: with a face there are other pieces, cut by other boxes
    assert (both <= np.minimum(alone + own, 1.0) + 1 / 2550).all()
    larger = np.maximum(alone, own)
    within = shrunk(larger > 0.99, 2 * round(face.body.raster.step))
    assert within.sum() > 20_000
    assert np.abs(larger - both)[within].max() < 0.05


def test_where_soft_mattes_of_face_and_hand_meet_nothing_is_lost(video: pvg.VectorVideo, face: FaceInFrame) -> None:
    """A hand before a face: the one matte begins as the other ends."""
    _, placed, whole = _placed(video, face)
    x0, y0, x1, y1 = placed.window
    whole[y0:y1, x0:x1] = cv2.GaussianBlur(placed.alpha, (0, 0), 12)
    both = whole + _on_grey(1 - whole, 4, [replace(placed, alpha=whole[y0:y1, x0:x1])])
    assert both[y0 + 40 : y1 - 40, x0 + 40 : x1 - 40].min() > 0.9
    assert both.max() < 1.001


def test_along_the_face_the_body_adds_no_rim_thinner_than_its_cells(video: pvg.VectorVideo, face: FaceInFrame) -> None:
    """A body's matte that is the face's own in coarse cells, a little wider: the finer edge stays."""
    _, placed, whole = _placed(video, face)
    wider = cv2.dilate(whole, np.ones((7, 7), np.uint8))
    rim = _on_grey(wider, 8, [placed])
    bare = np.maximum(_on_grey(wider, 8, []) - whole, 0)
    assert bare.sum() > 1000
    assert rim.sum() < 0.3 * bare.sum()


def test_the_extent_face_leaves_the_body_alone(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> None:
    frame = source_frame(video, 20)
    of_face, of_skin = (pvg.transfer(video, dark_reference, extent=extent) for extent in ("face", "skin"))
    assert not of_face.body
    assert set(of_skin.body) == set(of_skin.colors)
    source, face, skin = frame.rgb(), *(drawn.rgb() for drawn in Renderer(video, [of_face, of_skin]).draw(frame))
    data = video.face_at(0, 20)
    assert data is not None
    xs, ys = np.arange(frame.width, dtype=np.float32), np.arange(frame.height, dtype=np.float32)
    alpha = data.matte.alpha_at(xs, ys)
    axes, chin = data.landmarks.axes, data.landmarks.points[layout.CHIN]
    below = ((xs - chin[0]) * axes.down[0] + (ys[:, None] - chin[1]) * axes.down[1]) / axes.width
    outside, inner = shrunk(alpha == 0, 7), shrunk((alpha == 1) & (below < 0.4), 7)  # chroma is shared by neighbours
    np.testing.assert_array_equal(face[outside], source[outside])
    np.testing.assert_array_equal(face[inner], skin[inner])


def test_the_extent_face_ends_at_the_foot_of_the_neck(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> None:
    """A chest that lies in the face's own matte stays as it is, and nothing steps where the neck ends."""
    data = video.face_at(0, 20)
    assert data is not None
    placed = place_face(data, table_labels(), 640, 360)
    assert placed is not None
    open_chest = np.ones((400, placed.alpha.shape[1]), np.float32)
    axes, (_, chin) = data.landmarks.axes, data.landmarks.points[layout.CHIN]
    ends = without_chest(placed, open_chest)[:, placed.alpha.shape[1] // 2]
    below = (np.arange(400) + placed.y - chin) / axes.width  # of a face that is nearly upright
    assert (ends[below < 0.3] == 1.0).all()
    assert (ends[below > 0.95] == 0.0).all()
    assert np.abs(np.diff(ends)).max() < 4.0 / axes.width


def test_an_unknown_extent_is_refused(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> None:
    with pytest.raises(ValueError, match="extent"):
        pvg.transfer(video, dark_reference, extent="body")
