"""A look as files: cube and matte, applied as a grading suite would, give nearly the render."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from skimage.color import deltaE_ciede2000, rgb2lab

import pvg
from benchmarks.quality.lossless import write_lossless
from pvg.rendering import source_frame
from pvg.video import probe, read_frames, read_image
from scripts.samples import Samples
from tests.gallery.cubes import apply_cube, read_cube
from tests.gallery.scenes import resting_face


def graded(rgb: np.ndarray, cube: Path, matte: np.ndarray) -> np.ndarray:
    """What a grading suite makes of a frame (H, W, 3), 0-255, with a cube and a matte (H, W) in [0, 1]."""
    drawn = apply_cube(read_cube(cube), rgb.reshape(-1, 3).astype(np.float64)).reshape(rgb.shape)
    return np.asarray(rgb + matte[..., None] * (drawn - rgb))


@pytest.mark.parametrize(
    ("reference", "light", "most"),
    # light falls from a side, which no map of colour knows: on this grey clip it costs the dark look 0.1
    [("dark_reference", 0.0, 2.0), ("pale_reference", 0.0, 2.0), ("dark_reference", 0.25, 2.1)],
)
def test_cube_and_matte_give_nearly_the_render(
    reference: str, light: float, most: float, video: pvg.VectorVideo, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    look = pvg.transfer(video, request.getfixturevalue(reference), light=light)
    written = pvg.export(video, look, tmp_path)
    assert [path.name for path in written] == ["look.cube", "matte.mkv", "look-README.txt"]
    mattes = list(read_frames(tmp_path / "matte.mkv"))
    assert len(mattes) == video.frame_count
    for index in (0, 20):
        source, wanted = source_frame(video, index).rgb(), pvg.render_frame(video, look, index)
        matte = mattes[index].planes[0] / 255.0
        ours = np.clip(graded(source, tmp_path / "look.cube", matte), 0, 255)
        face = matte > 0.9
        assert face.mean() > 0.03
        error = deltaE_ciede2000(rgb2lab(ours[face] / 255.0), rgb2lab(wanted[face] / 255.0))
        changed = deltaE_ciede2000(rgb2lab(source[face] / 255.0), rgb2lab(wanted[face] / 255.0))
        assert np.median(error) < most
        assert np.median(error) < 0.4 * np.median(changed)
        # outside the matte nothing changes, in either
        outside = matte == 0
        assert np.abs(ours[outside] - source[outside]).max() == 0
        assert np.abs(wanted[outside].astype(int) - source[outside]).max() <= 4  # chroma of the pixels beside it
    lines = (tmp_path / "look-README.txt").read_text().splitlines()
    assert len(lines) == 3


def test_the_matte_keeps_the_clips_time_stamps_in_every_format(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    look = pvg.transfer(video, dark_reference, extent="face")
    assert video.source is not None
    stamps = [frame.time_s for frame in read_frames(video.source)]
    for matte, name in (("ffv1", "matte.mkv"), ("prores", "matte.mov")):
        folder = tmp_path / matte
        pvg.export(video, look, folder, matte=matte, size=5)
        frames = list(read_frames(folder / name))
        np.testing.assert_allclose([frame.time_s for frame in frames], stamps, atol=1e-3)
    assert probe(tmp_path / "prores" / "matte.mov").has_alpha
    pvg.export(video, look, tmp_path / "png", matte="png", size=5)
    pictures = sorted((tmp_path / "png" / "matte").iterdir())
    assert len(pictures) == video.frame_count
    first = next(read_frames(tmp_path / "ffv1" / "matte.mkv")).planes[0]
    np.testing.assert_array_equal(read_image(pictures[0]).planes[0], first)
    alpha = next(read_frames(tmp_path / "prores" / "matte.mov")).alpha
    assert alpha is not None
    top = 2 ** probe(tmp_path / "prores" / "matte.mov").format.depth - 1
    assert np.abs(alpha / top - first / 255.0).max() < 0.01


def test_a_picture_with_several_persons_has_a_cube_and_a_matte_for_each(
    group: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    look = pvg.transfer(group, dark_reference, faces=(0, 2))
    names = {path.name for path in pvg.export(group, look, tmp_path)}
    assert names == {"look-1.cube", "look-2.cube", "matte-1.png", "matte-2.png", "look-README.txt"}
    one, other = (read_image(tmp_path / f"matte-{k}.png").planes[0].astype(int) for k in (1, 2))
    assert (one > 200).any()
    assert (other > 200).any()
    assert (one + other).max() <= 256


def test_the_cube_of_a_clip_that_brightens_is_that_of_the_light_its_look_was_made_in(
    dark_reference: pvg.VectorVideo, samples: Samples, tmp_path: Path
) -> None:
    subject = resting_face(samples)
    gains = np.concatenate([np.full(5, 0.5), np.linspace(0.5, 1.0, 15), np.full(20, 1.0)])
    write_lossless(tmp_path / "clip.mp4", (np.rint(subject.rgb * gain).astype(np.uint8) for gain in gains))
    with pvg.vectorize(tmp_path / "clip.mp4") as video:
        look = pvg.transfer(video, dark_reference)
        exposures = look.maps[0].exposures
        assert exposures[0, 0] < 0.7
        pvg.export(video, look, tmp_path / "look", parts=["cube"])
        leading = video.records[0].key_frames[int(np.argmin(np.abs(exposures[:, 0] - 1.0)))].frame
        source, wanted = source_frame(video, leading).rgb(), pvg.render_frame(video, look, leading)
        ours = graded(source, tmp_path / "look" / "look.cube", np.ones(source.shape[:2]))
    luma = [one[subject.inner].astype(float) @ (0.299, 0.587, 0.114) for one in (ours, wanted)]
    assert abs(float(np.mean(luma[0] - luma[1]))) < 1.0


def test_an_export_that_fails_leaves_the_files_of_before(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    look = pvg.transfer(video, dark_reference)
    (tmp_path / "README.txt").write_text("of another project")
    pvg.export(video, look, tmp_path, size=5)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert before["README.txt"] == b"of another project"

    def cancel(stage: str, done: int, total: int) -> None:
        if done == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pvg.export(video, pvg.transfer(video, dark_reference, strength=0.5), tmp_path, progress=cancel)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_an_export_replaces_nothing_that_it_reads(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    source, reference = tmp_path / "matte.mkv", tmp_path / "matte" / "000003.png"
    source.write_bytes(video.require_source().read_bytes())
    reference.parent.mkdir()
    reference.write_bytes(b"a portrait")

    def never(*_: object) -> None:
        raise AssertionError

    with pvg.open_asset(video.path, source) as own:
        look = pvg.transfer(own, dark_reference)
        with pytest.raises(ValueError, match=r"matte\.mkv would be replaced"):
            pvg.export(own, look, tmp_path, progress=never)
        with pytest.raises(ValueError, match=r"files in .*matte would be replaced"):
            pvg.export(own, look, tmp_path, matte="png", keep=[reference], progress=never)
        (tmp_path / "look.cube").mkdir()
        with pytest.raises(IsADirectoryError, match=r"look\.cube"):
            pvg.export(own, look, tmp_path, matte="prores", progress=never)
        with pytest.raises(NotADirectoryError, match=r"matte\.mkv"):
            pvg.export(own, look, source, progress=never)
        with pytest.raises(ValueError, match="nodes a side"):
            pvg.export(own, look, tmp_path, matte="prores", size=1, progress=never)
    assert source.read_bytes() == video.require_source().read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {"matte.mkv", "matte", "look.cube"}


def test_pictures_of_a_longer_export_do_not_stay_among_the_new(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    folder = tmp_path / "matte"
    folder.mkdir()
    for name in ("000000.png", "000040.png", "123456.png", "notes.png", "000041.txt"):
        (folder / name).write_bytes(b"of before")
    pvg.export(video, pvg.transfer(video, dark_reference), tmp_path, parts=["matte"], matte="png")
    names = {f"{k:06d}.png" for k in range(video.frame_count)}
    assert {path.name for path in folder.iterdir()} == names | {"notes.png", "000041.txt"}
    assert read_image(folder / "000000.png").width == video.media.width


def test_a_matte_of_an_export_before_does_not_stay_beside_the_new(
    group: pvg.VectorVideo, video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    def export(own: pvg.VectorVideo, **options: Any) -> None:
        written = pvg.export(own, pvg.transfer(own, dark_reference), tmp_path, size=2, **options)
        notes = {tmp_path / "notes.mkv", tmp_path / "matte-7.mov"}
        assert set(tmp_path.iterdir()) - notes - unasked == set(written)

    unasked: set[Path] = set()
    export(group)
    (tmp_path / "notes.mkv").write_bytes(b"mine")  # and so is what no export names
    (tmp_path / "matte-7.mov").write_bytes(b"mine")
    for matte in ("ffv1", "png", "prores"):  # nor a cube or matte of a person who is in this one no more
        export(video, matte=matte)
    unasked = {tmp_path / "look.cube"}
    export(video, parts=["matte"])
    assert {(tmp_path / name).read_bytes() for name in ("notes.mkv", "matte-7.mov")} == {b"mine"}


def test_what_an_export_reads_stays_though_it_was_of_an_export_before(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    look = pvg.transfer(video, dark_reference)
    pvg.export(video, look, tmp_path, parts=["matte"], matte="png")
    (tmp_path / "matte" / "of-mine.txt").touch()
    pvg.export(video, look, tmp_path, parts=["matte"], keep=[tmp_path / "matte" / "000003.png"])
    assert {path.name for path in (tmp_path / "matte").iterdir()} == {"000003.png", "of-mine.txt"}


def test_what_is_to_be_kept_may_be_told_once(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    look = pvg.transfer(video, dark_reference)
    pvg.export(video, look, tmp_path, parts=["matte"], matte="prores")
    pvg.export(video, look, tmp_path, parts=["matte"], keep=(tmp_path / name for name in ["matte.mov"]))
    assert {path.name for path in tmp_path.iterdir()} == {"matte.mov", "matte.mkv", "look-README.txt"}


def test_an_export_that_fails_leaves_no_folder(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    def cancel(stage: str, done: int, total: int) -> None:
        raise KeyboardInterrupt

    look = pvg.transfer(video, dark_reference)
    for folder in (tmp_path / "suite", tmp_path / "looks" / "suite"):
        with pytest.raises(KeyboardInterrupt):
            pvg.export(video, look, folder, parts=["matte"], progress=cancel)
    assert list(tmp_path.iterdir()) == []


def test_names_are_given_as_a_sequence(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path) -> None:
    look = pvg.transfer(video, dark_reference)
    with pytest.raises(ValueError, match=r"parts must be a sequence of names, such as \['cube'\], not 'cube'"):
        pvg.export(video, look, tmp_path / "suite", parts="cube")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"keep must be a sequence of names, such as \['clip\.mp4'\]"):
        pvg.export(video, look, tmp_path / "suite", keep="clip.mp4")
    assert list(tmp_path.iterdir()) == []


def test_a_look_without_maps_is_refused(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    made = pvg.transfer(video, dark_reference, contrast=1.0, extent="face")
    for look in (pvg.Look(made.colors), pvg.transfer(video, dark_reference, faces=[])):
        with pytest.raises(ValueError, match="no map of colour for any face of the clip"):
            pvg.export(video, look, tmp_path / "suite")
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_matte_is_refused(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="not one of ffv1, prores, png"):
        pvg.export(video, pvg.transfer(video, dark_reference), tmp_path, matte="gif")  # type: ignore[arg-type]


def test_only_what_is_asked_for_is_made(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    look = pvg.transfer(video, dark_reference)
    for part, name, lines in (("cube", "look.cube", 2), ("matte", "matte.mkv", 1)):
        written = pvg.export(video, look, tmp_path / part, parts=iter([part]), size=5)  # type: ignore[arg-type]
        assert [path.name for path in written] == [name, "look-README.txt"]
        assert {path.name for path in (tmp_path / part).iterdir()} == {name, "look-README.txt"}
        assert len(written[-1].read_text().splitlines()) == lines
        assert written[-1].read_text().startswith(name)
    with pytest.raises(ValueError, match="not one of cube, matte"):
        pvg.export(video, look, tmp_path, parts=["look"])  # type: ignore[list-item]
