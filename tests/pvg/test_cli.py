"""The `pvg` command as a user runs it: a process, its files, its exit code and its one line."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from inspect import signature
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import pytest

import pvg
from pvg import _option_values, _outputs
from pvg import _options as cli
from pvg._look_options import LOOK_OPTIONS
from pvg.asset.writing import replace_manifest
from pvg.cli import main
from pvg.face import PARTS
from pvg.looks import MAKEUP, PROTECTABLE
from pvg.rendering import LAYERS, MATTES
from pvg.video import CONTAINERS, IMAGE_SUFFIXES, INPUT_COLORS, PIPED, probe, read_frames, read_image
from pvg.video.encoders import ENCODERS, Codec
from scripts.samples import Samples
from tests.conftest import cut_clip
from tests.gallery.clips import encode_raw, libav_frame
from tests.waiting import until

Run = Callable[..., "subprocess.CompletedProcess[str]"]


def run_process(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """The command as a shell starts it: what only a process shows, and all that libraries write by themselves."""
    command = [str(Path(sys.executable).with_name("pvg")), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str]) -> Run:
    """The same without a process of its own, which takes seconds to import everything."""

    def called(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
        code: object = 0
        capfd.readouterr()
        try:
            main([str(argument) for argument in arguments])
        except SystemExit as end:
            code = end.code
        assert isinstance(code, int)
        return subprocess.CompletedProcess(arguments, code, *capfd.readouterr())

    return called


@pytest.fixture(scope="module")
def clip(samples: Samples, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return cut_clip(samples.woman_clip, tmp_path_factory.mktemp("cli") / "clip.mp4", 0, 8)


@pytest.fixture(scope="module")
def asset(clip: Path) -> Path:
    result = run_process("vectorize", clip, "-o", clip.with_name("clip.pvg"))
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""  # no progress bar when piped
    return Path(result.stdout.strip())


@pytest.fixture(scope="module")
def reference_asset(samples: Samples, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("cli") / "reference.pvg"
    pvg.vectorize(samples.pale_portrait, asset=path).close()
    return path


def test_one_reference_writes_a_file(asset: Path, samples: Samples, tmp_path: Path) -> None:
    out = tmp_path / "out.mp4"
    result = run_process("transfer", asset, "--reference", samples.dark_portrait, "-o", out, "--contrast", "auto")
    assert (result.returncode, result.stdout, result.stderr) == (0, f"{out}\n", "")
    assert probe(out).frame_count == 8


def test_several_references_write_a_folder(
    run: Run, clip: Path, samples: Samples, reference_asset: Path, tmp_path: Path
) -> None:
    references = ["--reference", samples.dark_portrait, "--reference", reference_asset]
    result = run("transfer", clip, *references, "-o", tmp_path / "looks", "--strength", "0.5")
    assert result.returncode == 0, result.stderr
    names = sorted(path.name for path in (tmp_path / "looks").iterdir())
    assert names == sorted(f"{p.stem}.mp4" for p in (samples.dark_portrait, reference_asset))


def test_an_image_and_a_reference_asset(run: Run, samples: Samples, reference_asset: Path, tmp_path: Path) -> None:
    result = run("transfer", samples.portrait, "--reference", reference_asset, "-o", tmp_path / "out.png")
    assert result.returncode == 0, result.stderr
    before, after = (read_image(p).rgb().astype(int) for p in (samples.portrait, tmp_path / "out.png"))
    assert before.shape == after.shape
    assert (before != after).any()


def test_swap_writes_both(run: Run, asset: Path, samples: Samples, tmp_path: Path) -> None:
    result = run("swap", asset, samples.dark_portrait, "-o", tmp_path / "swapped")
    assert result.returncode == 0, result.stderr
    assert {path.suffix for path in (tmp_path / "swapped").iterdir()} == {".mp4", ".png"}


def test_swap_within_one_writes_a_file_and_warns_of_small_faces(
    run: Run, group: pvg.VectorVideo, tmp_path: Path
) -> None:
    out = tmp_path / "swapped.png"
    result = run("swap", group.path, "--faces", "1,4", "-o", out, "--contrast", "0.8,1.2")
    assert (result.returncode, result.stdout) == (0, f"{out}\n"), result.stderr
    expected = pvg.render_frame(group, pvg.exchange(group, (1, 4), contrast=(0.8, 1.2)), 0)
    np.testing.assert_array_equal(read_image(out).rgb(), expected)
    assert [line for line in result.stderr.splitlines() if ", face " in line] == [
        f"pvg: warning: group.pvg, face {face}: {group.faces[face].warnings[0]}" for face in (1, 4)
    ]


def test_a_face_of_a_group_is_the_reference(run: Run, asset: Path, group: pvg.VectorVideo, tmp_path: Path) -> None:
    out = tmp_path / "out.png"
    arguments = ["transfer", group.path, "--face", "0", "--reference", group.path, "-o", out]
    paper = ["--iterations", "5", "--beta", "0.5", "--seed", "3"]
    result = run(
        *arguments,
        "--reference-face",
        "2",
        "--makeup",
        "lips=1,cheeks=0.25",
        "--light",
        "0.5",
        "--protect",
        "none",
        *paper,
    )
    assert result.returncode == 0, result.stderr
    options = {
        "makeup": {"lips": 1.0, "cheeks": 0.25},
        "light": 0.5,
        "protect": (),
        "iterations": 5,
        "beta": 0.5,
        "seed": 3,
    }
    look = pvg.transfer(group, group, faces=[0], reference_face=2, **options)  # type: ignore[arg-type]
    np.testing.assert_array_equal(read_image(out).rgb(), pvg.render_frame(group, look, 0))
    # of those that take part, each once for the clip and once for the reference
    said = [line.split(": ")[2] for line in result.stderr.splitlines()]
    assert said[:2] == ["group.pvg, face 0", "group.pvg, face 2"]
    assert set(said[2:]) == {"out.png"}  # what the picture's file had besides


def test_an_export_is_a_folder_for_a_grading_suite(
    run: Run, asset: Path, reference_asset: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "suite"
    result = run("export", asset, "--reference", reference_asset, "-o", folder, "--matte", "png", "--light", "0")
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.splitlines() == [str(folder / name) for name in ("look.cube", "matte", "look-README.txt")]
    assert len(list((folder / "matte").iterdir())) == 8
    (tmp_path / "file").write_text("")
    refused = run("export", asset, "--reference", reference_asset, "-o", tmp_path / "file")
    assert refused.returncode == 2
    assert "is a file" in refused.stderr


def test_a_camera_logarithm_is_named_not_guessed(run: Run, clip: Path) -> None:
    plain = json.loads(run("inspect", clip).stdout)["media"]
    named = json.loads(run("inspect", clip, "--input-color", "slog3").stdout)["media"]
    assert (plain["color"], named["color"]) == ("SDR", "S-Log3")
    assert run("inspect", clip, "--input-color", "slog2").returncode == 2


def test_inspect_tells_of_a_picture_what_an_output_keeps(run: Run, samples: Samples) -> None:
    found = json.loads(run("inspect", samples.dark_portrait, "--container", "jpg").stdout)
    assert found["media"]["kind"] == "image"
    assert found["output"]["container"] == "jpg"
    assert isinstance(found["output"]["not_kept"], list)
    refused = json.loads(run("inspect", samples.dark_portrait, "--container", "mp4").stdout)
    assert "refused" in refused["output"]


def test_inspect_prints_a_summary(run: Run, asset: Path) -> None:
    result = run("inspect", asset)
    summary = json.loads(result.stdout)
    assert summary["media"]["frame_count"] == 8
    assert summary["faces"][0]["width_px"] > 100


def test_inspect_tells_of_a_clip_what_an_output_keeps(run: Run, clip: Path, samples: Samples) -> None:
    found = json.loads(run("inspect", clip, "--container", "mov", "--codec", "prores").stdout)
    assert found["media"]["frame_count"] == 8
    assert found["output"]["codec"] == "prores"
    assert "4:2:2, 10 bits" in found["output"]["changed"][0]
    assert found["output"]["not_kept"] == []
    refused = json.loads(run("inspect", clip, "--container", "webm", "--codec", "ffv1").stdout)["output"]["refused"]
    assert refused == "WebM holds vp9 or av1, not ffv1; write .mkv or --container nut"
    assert json.loads(run("inspect", samples.portrait).stdout)["media"]["kind"] == "image"
    assert run("inspect", clip, "--layer", "mask", "-o", clip.with_suffix(".png")).returncode == 2


def test_pictures_go_through_pipes(asset: Path, reference_asset: Path, tmp_path: Path) -> None:
    """Out of one command as a stream and into another, with nothing else on standard output."""
    look = ["--reference", str(reference_asset)]
    command = [str(Path(sys.executable).with_name("pvg")), "transfer", str(asset), *look]
    given = subprocess.run([*command, "--strength", "0", "-o", "-"], capture_output=True, timeout=300, check=True)
    assert given.stdout.startswith(b"nut/multimedia container\0")
    taken = subprocess.run(
        [*command, "--source", "-", "-o", "-", "--container", "y4m"],
        input=given.stdout,
        capture_output=True,
        timeout=300,
        check=True,
    )
    assert taken.stdout.startswith(b"YUV4MPEG2 W640 H360 F")
    assert taken.stdout.count(b"FRAME\n") >= 8
    assert b"standard output: " in taken.stderr
    bad = subprocess.run(
        [*command, "--source", "-", "-o", str(tmp_path / "o.mp4")],
        input=b"hello",
        capture_output=True,
        timeout=300,
        check=False,
    )
    assert bad.returncode == 3
    assert b"neither NUT nor YUV4MPEG2" in bad.stderr
    assert list(tmp_path.iterdir()) == []


def test_what_a_codec_changes_is_said(run: Run, asset: Path, reference_asset: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.mov"
    result = run("transfer", asset, "--reference", reference_asset, "-o", out, "--codec", "prores")
    assert (result.returncode, result.stdout) == (0, f"{out}\n")
    assert result.stderr.startswith("pvg: warning: out.mov: pictures become Y'CbCr 4:2:2, 10 bits")
    assert probe(out).codec == "prores"


@pytest.mark.parametrize("layer", ["image", "landmarks", "mask", "matte", "curves", "low", "high"])
def test_inspect_draws_every_layer(asset: Path, clip: Path, tmp_path: Path, layer: str) -> None:
    """In process, since starting the command seven times would only cost time."""
    with pvg.open_asset(asset, clip) as video:
        drawn = pvg.layer(video, 3, layer)
        image = pvg.layer(video, 3, "image")
    assert drawn.shape == image.shape == (360, 640, 3)
    assert drawn.dtype == np.uint8
    assert (layer == "image") == bool((drawn == image).all())


def test_inspect_writes_a_picture(run: Run, asset: Path, tmp_path: Path) -> None:
    result = run("inspect", asset, "--frame", "3", "--layer", "curves", "-o", tmp_path / "curves.png")
    assert result.returncode == 0, result.stderr
    assert read_image(tmp_path / "curves.png").rgb().shape == (360, 640, 3)


def test_bad_arguments_exit_with_2(
    run: Run, asset: Path, clip: Path, samples: Samples, reference_asset: Path, tmp_path: Path
) -> None:
    look = ["--reference", reference_asset]
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
        ["transfer", asset, *look, "-o", tmp_path / "o.mp4", "--protect", "hair"],
        ["transfer", asset, *look, "-o", tmp_path / "o.mp4", "--protect", "eyes,eyes"],
        ["transfer", asset, *look, "-o", tmp_path / "o.mp4", "--iterations", "-1"],
        ["transfer", asset, *look, *look, "-o", tmp_path / "o.mp4"],
        ["transfer", asset, *look, "-o", tmp_path / "o.mp4", "--container", "mkv"],
        ["transfer", asset, *look, "-o", tmp_path / "o.mp4", "--container", "nut"],
        ["transfer", asset, *look, "-o", tmp_path / "o.mov", "--codec", "ffv1"],
        ["transfer", clip, *look, "-o", tmp_path / "o.mov", "--codec", "ffv1"],
        ["transfer", asset, *look, "-o", tmp_path / "o.mov", "--codec", "prores", "--crf", "20"],
        ["transfer", asset, *look, "-o", "-", "--container", "mp4"],
        ["transfer", asset, *look, *look, "-o", "-"],
        ["transfer", clip, *look, "--source", "-", "-o", tmp_path / "o.mp4"],
        ["transfer", clip, *look, "--source", clip, "-o", tmp_path / "o.mp4"],
        ["export", clip, *look, "--source", clip, "-o", tmp_path / "o"],
        ["inspect", clip, "--source", clip],
        ["transfer", asset, *look, "-o", tmp_path / "o.mp4", "--crf", "52"],
        ["transfer", clip, *look, "-o", tmp_path / "o.mp4", "--crf", "52"],
        ["transfer", samples.portrait, *look, "-o", tmp_path / "o.png", "--crf", "20"],
        ["swap", samples.portrait, samples.dark_portrait, "-o", tmp_path / "o", "--audio", "none"],
        ["swap", asset, asset, "-o", tmp_path / "o"],
        ["swap", asset, clip, "-o", tmp_path / "o"],
        ["swap", asset, "-o", tmp_path / "o.mp4"],
        ["swap", asset, "--faces", "0,1", "-o", tmp_path / "o.mp4"],
        ["swap", asset, "--faces", "0,0", "-o", tmp_path / "o.mp4"],
        ["swap", asset, samples.portrait, "--faces", "0,1", "-o", tmp_path / "o"],
        ["inspect", asset, "--layer", "hair", "-o", tmp_path / "o.png"],
        ["inspect", asset, "--container", "mov"],
        ["inspect", asset, "--codec", "prores"],
        ["inspect", asset, "--frame", "3"],
        ["inspect", asset, "--strict"],
        ["inspect", samples.portrait, "--codec", "prores"],
        ["inspect", samples.portrait, "--audio", "none"],
        ["transfer", asset, *look, "-o", tmp_path / "o.mp4", "--input-color", "slog3"],
        ["transfer", asset, *look, "-o", tmp_path / "o.mp4", "--strict"],
        ["export", asset, *look, "-o", tmp_path / "o", "--strict"],
        ["swap", asset, reference_asset, "-o", tmp_path / "o", "--input-color", "slog3"],
        ["swap", asset, "--faces", "0,1", "-o", tmp_path / "o.mp4", "--strict"],
        ["inspect", asset, "--layer", "mask", "-o", tmp_path / "o.png", "--frame", "99"],
        ["paint", asset],
    ):
        result = run(*arguments)
        assert result.returncode == 2, (arguments, result.stderr)
    assert run_process("paint", asset).returncode == 2
    assert list(tmp_path.iterdir()) == []


def test_an_export_replaces_neither_its_clip_nor_its_reference(
    run: Run, clip: Path, reference_asset: Path, tmp_path: Path
) -> None:
    own, reference = tmp_path / "matte.mkv", tmp_path / "look.cube"
    shutil.copy(clip, own)
    shutil.copy(reference_asset, reference)
    for given, colors, kept in ((own, reference_asset, own), (clip, reference, reference)):
        result = run("export", given, "--reference", colors, "-o", tmp_path)
        assert result.returncode == 2
        assert f"{kept} would be replaced" in result.stderr
    assert own.read_bytes() == clip.read_bytes()
    assert reference.read_bytes() == reference_asset.read_bytes()


def test_a_swap_replaces_neither_clip(run: Run, asset: Path, clip: Path, samples: Samples, tmp_path: Path) -> None:
    own = tmp_path / "clip.mp4"
    shutil.copy(clip, own)
    result = run("swap", own, samples.dark_portrait, "-o", tmp_path)
    assert result.returncode == 2
    assert "clip.mp4 would be replaced" in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["clip.mp4"]


def test_a_closed_pipe_ends_quietly(asset: Path, reference_asset: Path) -> None:
    """Whoever reads has had enough, as `head` has."""
    command = [str(Path(sys.executable).with_name("pvg"))]
    for arguments in (["transfer", asset, "--reference", reference_asset, "-o", "-"], ["inspect", asset]):
        with subprocess.Popen(
            [*command, *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE
        ) as started:
            assert started.stdout is not None
            assert started.stderr is not None
            started.stdout.close()
            assert started.stderr.read() == b""
        assert started.returncode == 141


def test_names_in_another_coding_are_printed_as_their_bytes(asset: Path, tmp_path: Path) -> None:
    target = tmp_path / os.fsdecode(b"m\xff.png")
    command = [str(Path(sys.executable).with_name("pvg")), "inspect", str(asset), "--layer", "matte", "-o", str(target)]
    strict = {**os.environ, "PYTHONIOENCODING": "utf-8:strict"}  # as in most locales, not in that of C
    done = subprocess.run(command, env=strict, capture_output=True, timeout=300, check=True)
    assert done.stdout == os.fsencode(target) + b"\n"


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_closed_standard_streams_do_not_matter(closed: str, samples: Samples, tmp_path: Path) -> None:
    command = [str(Path(sys.executable).with_name("pvg")), "vectorize", str(samples.pale_portrait)]
    for target in (tmp_path / "open.pvg", tmp_path / "closed.pvg"):
        redirected = f'exec "$@" {closed if target.stem == "closed" else ""}'
        shell = ["sh", "-c", redirected, "sh", *command, "-o", str(target)]
        subprocess.run(shell, stdout=subprocess.DEVNULL, timeout=300, check=True)
    assert (tmp_path / "closed.pvg").read_bytes() == (tmp_path / "open.pvg").read_bytes()


def test_a_closed_standard_error_takes_names_in_another_coding(tmp_path: Path) -> None:
    named = tmp_path / os.fsdecode(b"m\xff.mp4")
    named.write_text("hello")
    command = [str(Path(sys.executable).with_name("pvg")), "vectorize", str(named), "-o", str(tmp_path / "out.pvg")]
    done = subprocess.run(["sh", "-c", 'exec "$@" 2>&-', "sh", *command], timeout=300, check=False)
    assert done.returncode == 3


def test_bad_input_exits_with_3_and_one_line(run: Run, samples: Samples, tmp_path: Path) -> None:
    text, ground = tmp_path / "text.mp4", tmp_path / "ground.mp4"
    text.write_text("hello")
    cut_clip(samples.no_face_clip, ground, 0, 4)
    for command, source, words in (
        (run, ground, "no face found"),
        (run_process, text, "text.mp4"),
        (run, tmp_path / "missing.mp4", "missing.mp4"),
    ):
        result = command("vectorize", source, "-o", tmp_path / "o.pvg")
        assert result.returncode == 3
        assert words in result.stderr
        assert result.stderr.count("\n") == 1
        assert result.stderr.startswith("pvg: ")
    assert {path.name for path in tmp_path.iterdir()} == {"text.mp4", "ground.mp4"}


def test_a_process_that_is_told_to_end_leaves_nothing_behind(samples: Samples, tmp_path: Path) -> None:
    """As `timeout`, `docker stop` and queues of jobs tell it; Ctrl-C likewise."""
    command = [str(Path(sys.executable).with_name("pvg")), "vectorize", str(samples.woman_full)]
    process = subprocess.Popen([*command, "-o", str(tmp_path / "clip.pvg")], stderr=subprocess.DEVNULL)
    until(lambda: list(tmp_path.iterdir()))
    process.send_signal(signal.SIGTERM)
    assert process.wait(120) == 128 + signal.SIGTERM
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("name", "said"), [("keep.mp4", "keep.mp4 is the name of a clip or picture"), ("-", "a pipe")])
def test_an_asset_is_written_to_no_clip_and_no_pipe(run: Run, clip: Path, tmp_path: Path, name: str, said: str) -> None:
    shutil.copy(clip, tmp_path / "keep.mp4")
    result = run("vectorize", clip, "-o", name if name == "-" else tmp_path / name)
    assert result.returncode == 2
    assert said in result.stderr
    assert (tmp_path / "keep.mp4").read_bytes() == clip.read_bytes()


def test_the_help_and_a_refusal_load_no_library(clip: Path, samples: Samples) -> None:
    """They are there at once: neither NumPy nor anything as heavy is imported for them."""
    script = (
        "import sys, contextlib, io, pvg.cli\n"
        "out = io.StringIO()\n"
        "with contextlib.suppress(SystemExit), contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):\n"
        "    pvg.cli.main(sys.argv[1:])\n"
        "assert out.getvalue()\n"
        "print(sorted({'numpy', 'cv2', 'av', 'numba', 'scipy', 'onnxruntime', 'typer', 'tqdm'} & set(sys.modules)))"
    )
    references = ["--reference", str(samples.portrait), "--reference", str(samples.dark_portrait)]
    refused = ["transfer", str(clip), *references, "-o", "a.mp4"]
    for arguments in (["--help"], ["transfer", "--help"], ["--version"], refused):
        done = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=True)
        assert done.stdout == "[]\n"


def test_the_help_says_what_parts_left_out_of_make_up_get(run: Run) -> None:
    for command in ("transfer", "swap", "export"):
        assert f"parts left out get {MAKEUP}" in " ".join(run(command, "--help").stdout.split())


def test_the_help_says_the_qualities_and_efforts_that_are_taken(run: Run) -> None:
    said = " ".join(run("transfer", "--help").stdout.split())
    scales = [(name, one.crf_most, one.crf) for name, one in ENCODERS.items() if one.crf is not None]
    (name, most, crf), *others = scales
    line = ", ".join([f"{name} 0-{most} (default {crf})", *(f"{name} 0-{most} ({crf})" for name, most, crf in others)])
    assert f"quality, lower is better: {line}" in said
    assert f"effort of h264, hevc, vp9 and av1 (default {ENCODERS['h264'].preset})" in said
    assert ENCODERS["h264"].preset == ENCODERS["hevc"].preset


def test_what_is_said_of_a_clip_is_not_said_of_its_look_again(
    run: Run, clip: Path, reference_asset: Path, tmp_path: Path
) -> None:
    deep = encode_raw(
        tmp_path / "deep.mkv", [libav_frame(frame.rgb(), "yuv420p10le") for frame in read_frames(clip)], "ffv1"
    )
    result = run("transfer", deep, "--reference", reference_asset, "-o", tmp_path / "out.mkv")
    assert result.returncode == 0
    assert result.stderr.count("does not say its transfer function") == 1
    assert run("vectorize", deep, "-o", tmp_path / "deep.pvg").returncode == 0
    later = run("transfer", tmp_path / "deep.pvg", "--reference", reference_asset, "-o", tmp_path / "out.mkv")
    assert later.stderr.count("does not say its transfer function") == 1


def test_a_transfer_between_assets_loads_no_network(asset: Path, reference_asset: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.mp4"
    script = (
        "import sys, pvg.cli; pvg.cli.main(sys.argv[1:]); "
        "print(sorted({'onnxruntime', 'onnx', 'tqdm', 'pvg.vectorization', 'scipy.ndimage'} & set(sys.modules)))"
    )
    arguments = ["transfer", asset, "--reference", reference_asset, "-o", out]
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


def test_the_options_of_a_look_are_the_librarys() -> None:
    parameters = signature(pvg.transfer).parameters.values()
    library = {one.name: one.default for one in parameters if one.kind is one.KEYWORD_ONLY}
    by_face = {"reference_face", "contrast", "faces"}
    assert {name: option["default"] for name, option in LOOK_OPTIONS.items()} == {
        name: default for name, default in library.items() if name not in by_face
    }


def test_the_choices_are_the_librarys() -> None:
    parameters = get_type_hints(pvg.vectorize)
    assert get_args(parameters["mask"]) == cli.MASKS
    assert get_args(parameters["matching"]) == cli.MATCHINGS
    assert get_args(Codec) == cli.CODECS
    assert set(PIPED) < set(cli.CLIP_CONTAINERS) <= set(CONTAINERS)
    assert (PARTS, PROTECTABLE) == (_option_values.PARTS, _option_values.PROTECTABLE)
    assert cli.LAYERS == LAYERS
    assert cli.MATTES == MATTES
    assert cli.INPUT_COLORS == INPUT_COLORS
    assert {f".{name}" for name in cli.IMAGE_CONTAINERS} <= set(IMAGE_SUFFIXES)
    assert cli.IMAGE_CONTAINERS == _outputs.IMAGES
    assert _outputs.PIPED == PIPED


def test_the_version() -> None:
    result = run_process("--version")
    assert (result.returncode, result.stdout) == (0, f"pvg {pvg.__version__}\n")


def test_an_asset_and_its_clip_may_move_together(
    run: Run, asset: Path, clip: Path, reference_asset: Path, tmp_path: Path
) -> None:
    (tmp_path / "moved").mkdir()
    for path in (asset, clip):
        shutil.copy(path, tmp_path / "moved")
    look = ["--reference", reference_asset, "-o", tmp_path / "o.mp4"]
    assert run("transfer", tmp_path / "moved" / asset.name, *look).returncode == 0


def test_an_asset_without_its_clip_names_it(run: Run, asset: Path, reference_asset: Path, tmp_path: Path) -> None:
    alone = tmp_path / "alone.pvg"
    alone.write_bytes(asset.read_bytes())
    result = run("transfer", alone, "--reference", reference_asset, "-o", tmp_path / "o.mp4")
    assert result.returncode == 3
    assert result.stderr.startswith("pvg: alone.pvg is drawn on clip.mp4")
    assert "--source" in result.stderr


def test_standard_input_in_the_place_of_a_file_is_refused_in_words(
    run: Run, asset: Path, reference_asset: Path, tmp_path: Path
) -> None:
    look, out = ["--reference", reference_asset], ["-o", tmp_path / "o.mp4"]
    folder, piped = ["-o", tmp_path / "o"], ["--source", "-"]
    cases: list[tuple[list[str | Path], str]] = [
        (["export", asset, *look, *piped, *folder], "--source - is for pictures that `pvg transfer` draws on"),
        (["inspect", asset, *piped, "--layer", "mask", "-o", tmp_path / "o.png"], "--source - is for pictures"),
        (["inspect", asset, *piped], "--source - is for pictures"),
        (["vectorize", "-", "-o", tmp_path / "o.pvg"], "- is standard input; clips, pictures and assets are read"),
        (["transfer", "-", *look, *out], "- is standard input"),
        (["transfer", asset, *look, "--reference", "-", *folder], "- is standard input"),
        (["export", asset, "--reference", "-", *folder], "- is standard input"),
        (["swap", asset, "-", *folder], "- is standard input"),
        (["inspect", "-"], "- is standard input"),
    ]
    for arguments, words in cases:
        result = run(*arguments)
        assert (result.returncode, result.stdout) == (2, ""), arguments
        assert result.stderr.startswith(f"pvg: {words}"), (arguments, result.stderr)
    assert list(tmp_path.iterdir()) == []


def test_an_asset_without_a_face_is_told_so(run: Run, asset: Path, reference_asset: Path, tmp_path: Path) -> None:
    none = tmp_path / "none.pvg"
    shutil.copy(asset, none)
    with pvg.open_asset(none) as video:
        replace_manifest(none, {**video.manifest, "faces": []})
    out = ["-o", tmp_path / "o.mp4"]
    for arguments in (
        ["transfer", none, "--reference", reference_asset, *out],
        ["transfer", asset, "--reference", none, *out],
        ["inspect", none],
    ):
        result = run(*arguments)
        assert (result.returncode, result.stdout) == (3, "")
        assert result.stderr.startswith("pvg: none.pvg has no face")
    assert [path.name for path in tmp_path.iterdir()] == ["none.pvg"]


def test_what_a_clip_cannot_be_written_as_is_refused_before_it_is_vectorised(
    run: Run,
    asset: Path,
    clip: Path,
    samples: Samples,
    reference_asset: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    begun: list[Path] = []
    monkeypatch.setattr("pvg.vectorize", lambda path, **_: begun.append(path))
    look, photo = ["--reference", reference_asset], samples.portrait
    of_asset = ["--reference", clip, "-o"]
    folder = ["-o", tmp_path / "o"]
    (tmp_path / "there").mkdir()
    cases: list[tuple[list[str | Path], str]] = [
        (["transfer", clip, *look, "-o", tmp_path / "o.png"], "must end in .mp4"),
        (["transfer", photo, *look, "-o", tmp_path / "o.mp4"], "must end in .png"),
        (["transfer", photo, *look, "-o", "-"], "a picture is written to a file"),
        (["transfer", photo, *look, "-o", tmp_path / "o.png", "--audio", "none"], "--audio is of clips"),
        (["transfer", clip, *look, "-o", tmp_path / "there", "--container", "png"], "png does not fit a clip"),
        (["transfer", clip, *look, "-o", tmp_path / "o.mov", "--codec", "ffv1"], "holds"),
        (["transfer", asset, *of_asset, tmp_path / "o.png"], "must end in .mp4"),
        (["transfer", asset, *of_asset, tmp_path / "o.mov", "--codec", "ffv1"], "holds"),
        (["transfer", asset, *of_asset, "-", "--crf", "20"], "has no crf"),
        (["swap", clip, photo, *folder, "--codec", "ffv1"], "holds"),
        (["swap", clip, photo, *folder, "--container", "webm"], "webm does not fit an image"),
        (["swap", photo, clip, *folder, "--container", "webm"], "webm does not fit an image"),
        (["swap", clip, samples.no_face_clip, *folder, "--container", "webm", "--codec", "h264"], "holds"),
        (["swap", clip, photo, *folder, "--crf", "60"], "crf of"),
        (["swap", photo, samples.dark_portrait, *folder, "--crf", "20"], "--crf is of clips"),
        (["swap", clip, "--faces", "0,1", "-o", tmp_path / "o.png"], "must end in .mp4"),
        (["swap", clip, "--faces", "0,1", "-o", tmp_path / "o.webm", "--codec", "h264"], "holds"),
    ]
    for arguments, words in cases:
        result = run(*arguments)
        assert result.returncode == 2, (arguments, result.stderr)
        assert words in result.stderr, (arguments, result.stderr)
        assert begun == [], arguments
    assert [path.name for path in tmp_path.iterdir()] == ["there"]


def test_outputs_are_refused_before_the_work_begins(
    run: Run, asset: Path, clip: Path, reference_asset: Path, tmp_path: Path
) -> None:
    """The input is no clip, which nobody gets to see: the output is looked at first."""
    text = tmp_path / "text.mp4"
    text.write_text("hello")
    look = ["--reference", reference_asset]
    cases: list[tuple[list[str | Path], int, str]] = [
        (["vectorize", text, "-o", tmp_path], 3, "Is a directory"),
        (["vectorize", text, "-o", tmp_path / "none" / "o.pvg"], 3, f"No such file or directory: {tmp_path}/none\n"),
        (["vectorize", text, "-o", text / "o.pvg"], 3, f"Not a directory: {text}\n"),
        (["vectorize", text, "-o", "/dev/null"], 2, "not a regular file"),
        (["vectorize", text, "-o", text], 2, "is the name of a clip or picture"),
        (["transfer", text, *look, "-o", tmp_path / "o.gif"], 2, "must end in"),
        (["transfer", text, *look, "-o", tmp_path / "o"], 2, "must end in"),
        (["transfer", text, *look, "-o", text], 2, "while it is read"),
        (["transfer", text, *look, "-o", tmp_path / "none" / "o.mp4"], 3, "No such file"),
        (["transfer", text, *look, "-o", tmp_path / "o.mp4", "--contrast", "3"], 2, "--contrast"),
        (["transfer", text, *look, "-o", tmp_path / "o.mp4", "--face", "x"], 2, "--face"),
        (["transfer", text, *look, *look, "-o", text / "looks"], 3, "Not a directory"),
        (["transfer", asset, *look, "-o", clip], 2, "while it is read"),
        (["transfer", asset, *look, "-o", tmp_path / "o.png"], 2, "must end in"),
        (["swap", text, text, "-o", text / "swapped"], 3, "Not a directory"),
        (["swap", text, text, "-o", tmp_path / "o.mp4"], 2, "is named as a file is"),
        (["swap", text, text, "-o", "-"], 2, "is a stream"),
        (["export", text, *look, "-o", tmp_path / "o.mp4"], 2, "is named as a file is"),
        (["export", text, *look, "-o", "-"], 2, "is a stream"),
        (["inspect", asset, "--layer", "mask", "-o", tmp_path / "o.mp4"], 2, "must end in"),
    ]
    for arguments, code, words in cases:
        result = run(*arguments)
        assert (result.returncode, "Traceback" in result.stderr) == (code, False), (arguments, result.stderr)
        assert words in result.stderr, (arguments, result.stderr)
    assert [path.name for path in tmp_path.iterdir()] == ["text.mp4"]
    assert probe(clip).frame_count == 8
