"""The `pvg` command as a user runs it: a process, its files, its exit code and its one line."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import pytest

import pvg
from pvg import cli
from pvg.face.parts import PARTS
from pvg.looks import BETA, ITERATIONS, LIGHT, MAKEUP
from pvg.rendering import LAYERS
from pvg.video import probe, read_image
from pvg.video.writing import Codec
from scripts.samples import Samples
from tests.conftest import cut_clip


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [str(Path(sys.executable).with_name("pvg")), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


@pytest.fixture(scope="module")
def clip(samples: Samples, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return cut_clip(samples.woman_clip, tmp_path_factory.mktemp("cli") / "clip.mp4", 0, 8)


@pytest.fixture(scope="module")
def asset(clip: Path) -> Path:
    result = run("vectorize", clip, "-o", clip.with_name("clip.pvg"))
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""  # no progress bar when piped
    return Path(result.stdout.strip())


def test_one_reference_writes_a_file(asset: Path, samples: Samples, tmp_path: Path) -> None:
    out = tmp_path / "out.mp4"
    result = run("transfer", asset, "--reference", samples.dark_portrait, "-o", out, "--contrast", "auto")
    assert (result.returncode, result.stdout, result.stderr) == (0, f"{out}\n", "")
    assert probe(out).frame_count == 8


def test_several_references_write_a_folder(clip: Path, samples: Samples, tmp_path: Path) -> None:
    references = ["--reference", samples.dark_portrait, "--reference", samples.pale_portrait]
    result = run("transfer", clip, *references, "-o", tmp_path / "looks", "--strength", "0.5")
    assert result.returncode == 0, result.stderr
    names = sorted(path.name for path in (tmp_path / "looks").iterdir())
    assert names == sorted(f"{p.stem}.mp4" for p in (samples.dark_portrait, samples.pale_portrait))


def test_an_image_and_a_reference_asset(samples: Samples, tmp_path: Path) -> None:
    reference = tmp_path / "reference.pvg"
    assert run("vectorize", samples.pale_portrait, "-o", reference).returncode == 0
    result = run("transfer", samples.portrait, "--reference", reference, "-o", tmp_path / "out.png")
    assert result.returncode == 0, result.stderr
    before, after = (read_image(p).rgb().astype(int) for p in (samples.portrait, tmp_path / "out.png"))
    assert before.shape == after.shape
    assert (before != after).any()


def test_swap_writes_both(clip: Path, samples: Samples, tmp_path: Path) -> None:
    result = run("swap", clip, samples.dark_portrait, "-o", tmp_path / "swapped")
    assert result.returncode == 0, result.stderr
    assert {path.suffix for path in (tmp_path / "swapped").iterdir()} == {".mp4", ".png"}


def test_swap_within_one_writes_a_file_and_warns_of_small_faces(group: pvg.VectorVideo, tmp_path: Path) -> None:
    out = tmp_path / "swapped.png"
    result = run("swap", group.path, "--faces", "1,4", "-o", out, "--contrast", "0.8,1.2")
    assert (result.returncode, result.stdout) == (0, f"{out}\n"), result.stderr
    expected = pvg.render_frame(group, pvg.exchange(group, (1, 4), contrast=(0.8, 1.2)), 0)
    np.testing.assert_array_equal(read_image(out).rgb(), expected)
    assert result.stderr.splitlines() == [
        f"pvg: warning: group.pvg, face {face}: {group.faces[face].warnings[0]}" for face in (1, 4)
    ]


def test_a_face_of_a_group_is_the_reference(asset: Path, group: pvg.VectorVideo, tmp_path: Path) -> None:
    out = tmp_path / "out.png"
    arguments = ["transfer", group.path, "--face", "0", "--reference", group.path, "-o", out]
    paper = ["--iterations", "5", "--beta", "0.5", "--seed", "3"]
    result = run(*arguments, "--reference-face", "2", "--makeup", "lips=1,cheeks=0.25", "--light", "0.5", *paper)
    assert result.returncode == 0, result.stderr
    options = {"makeup": {"lips": 1.0, "cheeks": 0.25}, "light": 0.5, "iterations": 5, "beta": 0.5, "seed": 3}
    look = pvg.transfer(group, group, faces=[0], reference_face=2, **options)  # type: ignore[arg-type]
    np.testing.assert_array_equal(read_image(out).rgb(), pvg.render_frame(group, look, 0))
    # of those that take part, each once for the clip and once for the reference
    assert [line.split(": ")[2] for line in result.stderr.splitlines()] == ["group.pvg, face 0", "group.pvg, face 2"]


def test_inspect_prints_a_summary(asset: Path) -> None:
    result = run("inspect", asset)
    summary = json.loads(result.stdout)
    assert summary["media"]["frame_count"] == 8
    assert summary["faces"][0]["width_px"] > 100


@pytest.mark.parametrize("layer", ["image", "landmarks", "mask", "matte", "curves", "low", "high"])
def test_inspect_draws_every_layer(asset: Path, clip: Path, tmp_path: Path, layer: str) -> None:
    """In process, since starting the command seven times would only cost time."""
    with pvg.open_asset(asset, clip) as video:
        drawn = pvg.layer(video, 3, layer)
        image = pvg.layer(video, 3, "image")
    assert drawn.shape == image.shape == (360, 640, 3)
    assert drawn.dtype == np.uint8
    assert (layer == "image") == bool((drawn == image).all())


def test_inspect_writes_a_picture(asset: Path, tmp_path: Path) -> None:
    result = run("inspect", asset, "--frame", "3", "--layer", "curves", "-o", tmp_path / "curves.png")
    assert result.returncode == 0, result.stderr
    assert read_image(tmp_path / "curves.png").rgb().shape == (360, 640, 3)


def test_bad_arguments_exit_with_2(asset: Path, clip: Path, samples: Samples, tmp_path: Path) -> None:
    look = ["--reference", samples.dark_portrait]
    for arguments in (
        ["transfer", asset, *look, "-o", tmp_path / "o.mp4", "--contrast", "3"],
        ["transfer", asset, *look, "-o", tmp_path / "o.mp4", "--contrast", "strong"],
        ["transfer", asset, *look, "-o", tmp_path / "o.mp4", "--strength", "2"],
        ["transfer", asset, *look, "-o", tmp_path / "o.mp4", "--face", "7"],
        ["transfer", asset, *look, "-o", tmp_path / "o.mp4", "--reference-face", "1"],
        ["transfer", asset, *look, "-o", tmp_path / "o.mp4", "--beta", "0"],
        ["transfer", asset, *look, "-o", tmp_path / "o.mp4", "--light", "1.5"],
        ["transfer", asset, *look, "-o", tmp_path / "o.mp4", "--makeup", "2"],
        ["transfer", asset, *look, "-o", tmp_path / "o.mp4", "--makeup", "nose=1"],
        ["transfer", asset, *look, "-o", tmp_path / "o.mp4", "--makeup", "lips=1,lips=0"],
        ["transfer", asset, *look, "-o", tmp_path / "o.mp4", "--iterations", "-1"],
        ["transfer", asset, *look, *look, "-o", tmp_path / "o.mp4"],
        ["swap", asset, asset, "-o", tmp_path / "o"],
        ["swap", asset, clip, "-o", tmp_path / "o"],
        ["swap", asset, "-o", tmp_path / "o.mp4"],
        ["swap", asset, "--faces", "0,1", "-o", tmp_path / "o.mp4"],
        ["swap", asset, "--faces", "0,0", "-o", tmp_path / "o.mp4"],
        ["swap", asset, samples.portrait, "--faces", "0,1", "-o", tmp_path / "o"],
        ["inspect", asset, "--layer", "hair", "-o", tmp_path / "o.png"],
        ["inspect", asset, "--layer", "mask", "-o", tmp_path / "o.png", "--frame", "99"],
        ["paint", asset],
    ):
        result = run(*arguments)
        assert result.returncode == 2, (arguments, result.stderr)
    assert list(tmp_path.iterdir()) == []


def test_bad_input_exits_with_3_and_one_line(samples: Samples, tmp_path: Path) -> None:
    text = tmp_path / "text.mp4"
    text.write_text("hello")
    for source, words in (
        (samples.no_face_clip, "no face found"),
        (text, "text.mp4"),
        (tmp_path / "missing.mp4", "missing.mp4"),
    ):
        result = run("vectorize", source, "-o", tmp_path / "o.pvg")
        assert result.returncode == 3
        assert words in result.stderr
        assert result.stderr.count("\n") == 1
        assert result.stderr.startswith("pvg: ")
    assert [path.name for path in tmp_path.iterdir()] == ["text.mp4"]


def test_the_help_loads_no_library() -> None:
    """It is there at once: neither NumPy nor anything as heavy is imported for it."""
    script = (
        "import sys, contextlib, io, pvg.cli\n"
        "with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()) as out:\n"
        "    pvg.cli.main(sys.argv[1:])\n"
        "assert out.getvalue()\n"
        "print(sorted({'numpy', 'cv2', 'av', 'numba', 'scipy', 'onnxruntime', 'typer', 'tqdm'} & set(sys.modules)))"
    )
    for arguments in (["--help"], ["transfer", "--help"], ["--version"]):
        done = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=True)
        assert done.stdout == "[]\n"


def test_a_transfer_between_assets_loads_no_network(asset: Path, samples: Samples, tmp_path: Path) -> None:
    reference, out = tmp_path / "reference.pvg", tmp_path / "out.mp4"
    assert run("vectorize", samples.pale_portrait, "-o", reference).returncode == 0
    script = (
        "import sys, pvg.cli; pvg.cli.main(sys.argv[1:]); "
        "print(sorted({'onnxruntime', 'onnx', 'tqdm', 'pvg.vectorization', 'scipy.ndimage'} & set(sys.modules)))"
    )
    arguments = ["transfer", asset, "--reference", reference, "-o", out]
    done = subprocess.run(
        [sys.executable, "-c", script, *map(str, arguments)], capture_output=True, text=True, check=True
    )
    assert done.stdout == f"{out}\n[]\n"


def test_everything_public_is_there_and_known_to_completion() -> None:
    assert set(pvg.__all__) <= set(dir(pvg))
    for name in pvg.__all__:
        assert getattr(pvg, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        pvg.nothing  # type: ignore[attr-defined]  # noqa: B018


def test_the_choices_are_the_librarys() -> None:
    parameters = get_type_hints(pvg.vectorize)
    assert get_args(parameters["mask"]) == cli.MASKS
    assert get_args(parameters["matching"]) == cli.MATCHINGS
    assert get_args(Codec) == cli.CODECS
    assert (MAKEUP, LIGHT, BETA, ITERATIONS) == (cli.MAKEUP, cli.LIGHT, cli.BETA, cli.ITERATIONS)
    assert PARTS == cli.PARTS
    assert cli.LAYERS == LAYERS


def test_the_version() -> None:
    result = run("--version")
    assert (result.returncode, result.stdout) == (0, f"pvg {pvg.__version__}\n")


def test_an_asset_and_its_clip_may_move_together(asset: Path, clip: Path, samples: Samples, tmp_path: Path) -> None:
    (tmp_path / "moved").mkdir()
    for path in (asset, clip):
        shutil.copy(path, tmp_path / "moved")
    look = ["--reference", samples.dark_portrait, "-o", tmp_path / "o.mp4"]
    assert run("transfer", tmp_path / "moved" / asset.name, *look).returncode == 0


def test_an_asset_without_its_clip_names_it(asset: Path, samples: Samples, tmp_path: Path) -> None:
    alone = tmp_path / "alone.pvg"
    alone.write_bytes(asset.read_bytes())
    result = run("transfer", alone, "--reference", samples.dark_portrait, "-o", tmp_path / "o.mp4")
    assert result.returncode == 3
    assert result.stderr.startswith("pvg: alone.pvg is drawn on clip.mp4")
    assert "--source" in result.stderr


def test_outputs_are_refused_before_the_work_begins(asset: Path, clip: Path, samples: Samples, tmp_path: Path) -> None:
    """The input is no clip, which nobody gets to see: the output is looked at first."""
    text = tmp_path / "text.mp4"
    text.write_text("hello")
    look = ["--reference", samples.dark_portrait]
    cases: list[tuple[list[str | Path], int, str]] = [
        (["vectorize", text, "-o", tmp_path], 3, "Is a directory"),
        (["vectorize", text, "-o", tmp_path / "none" / "o.pvg"], 3, f"No such file or directory: {tmp_path}/none\n"),
        (["vectorize", text, "-o", text / "o.pvg"], 3, f"Not a directory: {text}\n"),
        (["vectorize", text, "-o", "/dev/null"], 2, "not a regular file"),
        (["vectorize", text, "-o", text], 2, "is read by this"),
        (["transfer", text, *look, "-o", tmp_path / "o.gif"], 2, "must end in"),
        (["transfer", text, *look, "-o", tmp_path / "o"], 2, "must end in"),
        (["transfer", text, *look, "-o", text], 2, "is read by this"),
        (["transfer", text, *look, "-o", tmp_path / "none" / "o.mp4"], 3, "No such file"),
        (["transfer", text, *look, "-o", tmp_path / "o.mp4", "--contrast", "3"], 2, "--contrast"),
        (["transfer", text, *look, "-o", tmp_path / "o.mp4", "--face", "x"], 2, "--face"),
        (["transfer", text, *look, *look, "-o", text / "looks"], 3, "Not a directory"),
        (["transfer", asset, *look, "-o", clip], 2, "is read by this"),
        (["transfer", asset, *look, "-o", tmp_path / "o.png"], 2, "must end in"),
        (["swap", text, text, "-o", text], 3, "Not a directory"),
        (["inspect", asset, "--layer", "mask", "-o", tmp_path / "o.mp4"], 2, "must end in"),
    ]
    for arguments, code, words in cases:
        result = run(*arguments)
        assert (result.returncode, "Traceback" in result.stderr) == (code, False), (arguments, result.stderr)
        assert words in result.stderr, (arguments, result.stderr)
    assert [path.name for path in tmp_path.iterdir()] == ["text.mp4"]
    assert probe(clip).frame_count == 8
