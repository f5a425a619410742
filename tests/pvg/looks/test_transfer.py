from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pvg
from pvg.curves import table_labels
from pvg.face import PARTS
from pvg.looks.complexion import complexion
from pvg.looks.exposure import at_exposure
from pvg.looks.opponent import to_rgb
from pvg.looks.transfer import _into_gamut
from pvg.rendering import Stills, join_parts, render_part
from pvg.video import VideoWriter, probe, read_frames
from scripts.samples import Samples


def test_the_same_seed_gives_the_same_look(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> None:
    one, two, other = (pvg.transfer(video, dark_reference, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.colors[0], two.colors[0])
    assert (one.colors[0] != other.colors[0]).any()


def test_strength_is_the_way_to_the_reference(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> None:
    g = video.records[0].key_frames[0].colors
    full, half = (pvg.transfer(video, dark_reference, strength=s).colors[0][0] for s in (1.0, 0.5))
    np.testing.assert_allclose(half, (g + full) / 2, atol=1e-3)


def test_makeup_takes_lips_towards_the_references_and_their_shades_stay(
    video: pvg.VectorVideo, pale_reference: pvg.VectorVideo
) -> None:
    """Lips go as F takes them, and their cover gains one change, of which `makeup` is the share or a power of it."""
    lips, lids, brows = (PARTS.index(part) for part in ("lips", "lids", "brows"))
    none, half, full = (pvg.transfer(video, pale_reference, makeup=share) for share in (0.0, 0.5, 1.0))
    np.testing.assert_array_equal(none.colors[0], full.colors[0])
    assert not np.delete(none.parts[0], [lips, brows], axis=1).any()
    taken = np.full((len(PARTS), 1), 1 / 2, np.float32)
    taken[lips], taken[lids] = 1 / 4, 1 / 64  # these lips are redder than the clip's
    np.testing.assert_allclose(half.parts[0], none.parts[0] + taken * (full.parts[0] - none.parts[0]), atol=1e-5)
    assert np.abs((full.parts[0] - none.parts[0])[0, lips]).max() > 2.0
    assert not pvg.transfer(video, pale_reference, match="color").parts
    only = pvg.transfer(video, pale_reference, makeup={"lips": 1.0, "lids": 0.0, "cheeks": 0.0, "brows": 0.0})
    assert np.flatnonzero(only.parts[0].any(axis=(0, 2))).tolist() == sorted([lips, brows])


def test_makeup_is_lit_by_the_lamp_that_the_face_is_in(
    video: pvg.VectorVideo, pale_reference: pvg.VectorVideo, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second key frame of the same face in blue light."""
    key, lips = video.records[0].key_frames[0], PARTS.index("lips")
    blue = replace(at_exposure(key, np.array((0.3, 0.6, 1.3))), frame=key.frame + 6, since=key.frame)
    lit = replace(video.records[0], key_frames=(key, blue))
    monkeypatch.setattr(video, "records", (lit, *video.records[1:]))
    look = pvg.transfer(video, pale_reference, makeup=1.0)
    (_, _, *white), (_, kept, *tint) = look.maps[0].exposures
    assert white == [1.0, 1.0, 1.0]
    usual, under_lamp = to_rgb(look.parts[0][:, lips].astype(np.float64))
    np.testing.assert_allclose(under_lamp, kept * np.array(tint) * usual, rtol=0.25)


def test_of_all_colours_together_the_rest_of_the_skin_goes_where_the_face_does(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo
) -> None:
    """Both to the reference's own colours, however far they lie; with `scene` they stopped on the way."""
    look = pvg.transfer(video, dark_reference, match="color", contrast=1.0)
    skin = table_labels().on_open_skin
    before, after = video.records[0].key_frames[0].colors[skin], look.colors[0][0][skin]
    _, new = look.maps[0].usual_colors("beside")
    rest = new[round(float(np.median(before @ (0.299, 0.587, 0.114))))]
    assert np.abs(rest - np.median(after, axis=0)).max() < 12
    assert np.abs(np.median(before, axis=0) - np.median(after, axis=0)).max() > 40


def test_a_flat_face_is_not_blotched_by_a_shaded_reference(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo
) -> None:
    """Skin-coloured curve samples keep their differences within the map's bounds: gain per channel times 1.25."""
    key = video.records[0].key_frames[0]
    new = pvg.transfer(video, dark_reference, match="semantic").colors[0][0]
    skin = table_labels().on_group("skin") & key.visible
    ratio = (np.median(new[skin], axis=0) + 8) / (np.median(key.colors[skin], axis=0) + 8)
    before, after = np.ptp(key.colors[skin], axis=0), np.ptp(new[skin], axis=0)
    assert (after <= 1.3 * ratio.max() * before + 1.0).all()


def test_the_references_face_is_its_largest_or_the_one_asked_for(
    video: pvg.VectorVideo, group: pvg.VectorVideo
) -> None:
    largest = max(group.faces, key=lambda face: face.width_px).index
    looks = [pvg.transfer(video, group, reference_face=face.index, scene=0.0, light=0.0) for face in group.faces]
    asked_for_none = pvg.transfer(video, group, scene=0.0, light=0.0)
    np.testing.assert_array_equal(asked_for_none.colors[0], looks[largest].colors[0])
    own = video.records[0].key_frames[0].skin
    middle = np.median(own, axis=0)[None]
    ours = np.concatenate([look.maps[0].skin(middle) for look in looks])
    goals = [complexion(record.key_frames[0].skin, own, 0.0) for record in group.records]
    theirs = np.stack([np.median(goal, axis=0) for goal in goals])
    np.testing.assert_allclose(ours, theirs, atol=7)
    nearest = np.linalg.norm(ours[:, None] - theirs[None], axis=2).argmin(axis=1)
    np.testing.assert_array_equal(nearest, np.arange(len(looks)))
    assert np.ptp(theirs, axis=0).min() > 20


def test_new_colours_stay_colours(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> None:
    colors = pvg.transfer(video, dark_reference).colors[0]
    assert colors.min() >= 0
    assert colors.max() <= 255


def test_a_face_left_out_of_the_look_is_not_in_it(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> None:
    assert pvg.transfer(video, dark_reference, faces=[]).colors == {}
    assert set(pvg.transfer(video, dark_reference, faces=[0]).colors) == {0}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"strength": 1.2}, "strength"),
        ({"strength": float("nan")}, "strength"),
        ({"contrast": 0.5}, "contrast"),
        ({"contrast": "much"}, "contrast"),
        ({"match": "hue"}, "match"),
        ({"protect": ["hair"]}, "protect"),
        ({"faces": [4]}, "no face 4; this clip has face 0 only"),
        ({"reference_face": 1}, "no face 1; this reference has face 0 only"),
        ({"reference_face": -1}, "no face -1"),
        ({"beta": 1.5}, "beta"),
        ({"beta": 0}, "beta must be above 0"),
        ({"protect": "eyes"}, "protect must be a sequence of eyes, teeth, not 'eyes'"),
        ({"protect": None}, "protect must be a sequence"),
        ({"iterations": -1}, "iterations"),
        ({"iterations": 10_001}, "iterations must be a whole number from 0 to 10000"),
        ({"strength": "0.5"}, "strength must be a number"),
        ({"strength": 10**400}, "strength must be a number"),
        ({"light": None}, "light must be a number"),
        ({"scene": True}, "scene must be a number"),
        ({"contrast": None}, "contrast must be"),
        ({"contrast": True}, "contrast must be"),
        ({"makeup": "much"}, "makeup of lips must be a number"),
        ({"makeup": {"lips": None}}, "makeup of lips must be a number"),
        ({"beta": "0.2"}, "beta must be a number"),
        ({"iterations": 2.5}, "iterations must be a whole number"),
        ({"seed": "x"}, "seed must be a whole number"),
        ({"faces": 0}, "faces must be"),
        ({"faces": "0"}, "faces must be"),
        ({"faces": [0.9]}, "each of faces must be a whole number, not 0.9"),
        ({"reference_face": 0.5}, "reference_face must be a whole number, not 0.5"),
        ({"extent": None}, "extent must be one of"),
    ],
)
def test_parameters_out_of_range_are_named(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, options: dict[str, object], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        pvg.transfer(video, dark_reference, **options)  # type: ignore[arg-type]


def test_a_path_in_the_place_of_a_video_is_told_what_to_do(
    video: pvg.VectorVideo, samples: Samples, tmp_path: Path
) -> None:
    path, out, look = samples.pale_portrait, tmp_path / "out.mp4", pvg.transfer(video, video)
    calls: list[Callable[[], object]] = [
        lambda: pvg.transfer(video, path),  # type: ignore[arg-type]
        lambda: pvg.transfer(str(path), video),  # type: ignore[arg-type]
        lambda: pvg.exchange(path, (0, 1)),  # type: ignore[arg-type]
        lambda: pvg.swap(video, path, [out, out]),  # type: ignore[arg-type]
        lambda: pvg.swap(str(path), paths=out, faces=(0, 1)),  # type: ignore[arg-type]
        lambda: pvg.render(path, [look], [out]),  # type: ignore[arg-type]
        lambda: render_part(path, [look], [out], start=0, stop=1, container="mp4"),  # type: ignore[arg-type]
        lambda: join_parts(path, [[out]], [out]),  # type: ignore[arg-type]
        lambda: pvg.render_frame(path, look, 0),  # type: ignore[arg-type]
        lambda: pvg.layer(path, 0, "mask"),  # type: ignore[arg-type]
        lambda: pvg.export(path, look, tmp_path),  # type: ignore[arg-type]
        lambda: Stills(path),  # type: ignore[arg-type]
    ]
    for call in calls:
        with pytest.raises(ValueError, match=r"is a path: give what pvg\.vectorize or pvg\.open_asset returns"):
            call()


def test_what_is_no_clip_or_no_look_is_refused_in_words(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    out, look = tmp_path / "out.mp4", pvg.transfer(video, dark_reference)
    no_clips: list[Callable[[], object]] = [
        lambda: pvg.transfer(video, [dark_reference]),  # type: ignore[arg-type]
        lambda: pvg.transfer(None, dark_reference),  # type: ignore[arg-type]
        lambda: pvg.exchange(look, (0, 1)),  # type: ignore[arg-type]
        lambda: pvg.swap(video, look, [out, out]),  # type: ignore[arg-type]
        lambda: pvg.render(look, [look], [out]),  # type: ignore[arg-type]
        lambda: pvg.layer(look, 0, "mask"),  # type: ignore[arg-type]
    ]
    for call in no_clips:
        with pytest.raises(ValueError, match=r"nothing that was vectorised: give what pvg\.vectorize or"):
            call()
    no_looks: list[Callable[[], object]] = [
        lambda: pvg.render(video, [dark_reference], [out]),  # type: ignore[list-item]
        lambda: render_part(video, [dark_reference], [out], start=0, stop=1, container="mp4"),  # type: ignore[list-item]
        lambda: pvg.render_frame(video, [look], 0),  # type: ignore[arg-type]
        lambda: pvg.export(video, dark_reference, tmp_path),  # type: ignore[arg-type]
        lambda: look.merged([look]),  # type: ignore[arg-type]
    ]
    for call in no_looks:
        with pytest.raises(ValueError, match=r"a look is what pvg\.transfer or pvg\.exchange returns, not"):
            call()
    with pytest.raises(ValueError, match="paths must be a path or two of them, not 3"):
        pvg.swap(video, dark_reference, 3)  # type: ignore[arg-type]


def test_numbers_may_be_numpys(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo) -> None:
    plain = pvg.transfer(video, dark_reference, contrast=1.25, makeup={"lips": 0.5}, strength=0.5, seed=3, faces=[0])
    of_numpy = pvg.transfer(
        video,
        dark_reference,
        contrast=np.float32(1.25),  # type: ignore[arg-type]
        makeup={"lips": np.float32(0.5)},  # type: ignore[dict-item]
        strength=np.float64(0.5),
        seed=np.int64(3),  # type: ignore[arg-type]
        faces=np.arange(1),  # type: ignore[arg-type]
    )
    np.testing.assert_array_equal(of_numpy.colors[0], plain.colors[0])
    np.testing.assert_array_equal(of_numpy.parts[0], plain.parts[0])
    assert of_numpy.contrast_of(0) == plain.contrast_of(0) == 1.125


def test_parts_left_out_of_make_up_have_its_default(video: pvg.VectorVideo, pale_reference: pvg.VectorVideo) -> None:
    by_part = pvg.transfer(video, pale_reference, makeup={"lids": 0.75})
    np.testing.assert_array_equal(by_part.parts[0], pvg.transfer(video, pale_reference).parts[0])


def test_two_faces_that_exchange_their_colours_have_no_other_reference(group: pvg.VectorVideo) -> None:
    with pytest.raises(ValueError, match="reference_face is none"):
        pvg.exchange(group, (0, 1), reference_face=0)
    with pytest.raises(ValueError, match="reference_face is none"):
        pvg.swap(group, paths="never.png", faces=(0, 1), reference_face=2)
    with pytest.raises(ValueError, match="faces must be"):
        pvg.exchange(group, 0)  # type: ignore[arg-type]
    assert set(pvg.exchange(group, (0, 1), reference_face=None).colors) == {0, 1}


_BLACK = (16, 128, 128)


@pytest.fixture(scope="module")
def two_shots(samples: Samples, tmp_path_factory: pytest.TempPathFactory) -> Iterator[pvg.VectorVideo]:
    """The same woman before and after a short shot of a coloured wall, then in 0.7 of the light."""
    folder = tmp_path_factory.mktemp("shots")
    info = probe(samples.woman_clip)
    frames = list(read_frames(samples.woman_clip, start=20, stop=36))
    frames += frames[:14]
    path = folder / "shots.mp4"
    with VideoWriter(path, info, info.format, crf=12) as writer:
        for index, frame in enumerate(frames):
            light = 1.0 if index < 12 else 0.7
            lit = [
                np.rint(black + (p - np.float32(black)) * light) for p, black in zip(frame.planes, _BLACK, strict=True)
            ]
            if 12 <= index < 16:
                lit = [np.broadcast_to(np.linspace(60, 200, p.shape[1]), p.shape) for p in frame.planes]
            y, cb, cr = (p.astype(np.uint8) for p in lit)
            writer.write(replace(frame, index=index, pts=1001 * index, planes=(y, cb, cr)))
    with pvg.vectorize(path, asset=folder / "shots.pvg") as vectorized:
        yield vectorized


@pytest.mark.parametrize("match", ["semantic", "color"])
def test_a_person_seen_in_two_shots_moves_by_one_map_so_the_darker_shot_stays_darker(
    two_shots: pvg.VectorVideo, pale_reference: pvg.VectorVideo, match: str
) -> None:
    assert two_shots.persons == ((1, 0),)
    look = pvg.transfer(two_shots, pale_reference, match=match)
    skin = table_labels().on_open_skin

    def brightness(colors: dict[int, np.ndarray]) -> tuple[float, float]:
        first, second = (float(np.median(colors[face][0][skin].mean(axis=1))) for face in (0, 1))
        return first, second

    before = brightness({face: record.key_frames[0].colors[None] for face, record in enumerate(two_shots.records)})
    after = brightness(look.colors)
    assert before[1] < 0.75 * before[0]
    assert after[1] / after[0] == pytest.approx(before[1] / before[0], abs=0.12)
    leader_alone = pvg.transfer(two_shots, pale_reference, match=match, faces=[1])
    np.testing.assert_array_equal(leader_alone.colors[1], look.colors[1])
    follower_alone = pvg.transfer(two_shots, pale_reference, match=match, faces=[0])
    np.testing.assert_array_equal(follower_alone.colors[0], look.colors[0])


def test_colours_brighter_than_white_are_darkened_in_their_own_hue() -> None:
    into = _into_gamut(np.array([[352.0, 321.0, 300.0], [255.0, 10.0, 0.0], [-4.0, 20.0, 30.0]]))
    np.testing.assert_allclose(into[0] / into[0, 0], [1.0, 321 / 352, 300 / 352])
    assert into[0, 0] == pytest.approx(255.0)
    np.testing.assert_array_equal(into[1:], [[255.0, 10.0, 0.0], [0.0, 20.0, 30.0]])


def test_automatic_contrast_is_the_papers_one_without_a_map_of_the_skin(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, samples: Samples, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There is none when all colours move together, nor when too little open skin is seen on either side."""
    assert pvg.transfer(video, dark_reference).contrast_of(0) == "map"
    assert pvg.transfer(video, dark_reference, match="color").contrast_of(0) == 1.0
    with pvg.vectorize(samples.dark_portrait, reference=True) as reference:
        (record,) = reference.records
        (key,) = record.key_frames
        hidden = replace(record, key_frames=(replace(key, skin=key.skin[:0], skin_at=key.skin_at[:0]),))
        monkeypatch.setattr(reference, "records", (hidden,))
        auto, one = (pvg.transfer(video, reference, contrast=contrast) for contrast in ("auto", 1.0))
        assert auto.contrast_of(0) == 1.0
        np.testing.assert_array_equal(auto.colors[0], one.colors[0])
