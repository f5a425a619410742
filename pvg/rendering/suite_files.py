"""A look as files for a grading suite: its one map of colour as a .cube, its matte as a grey clip.

A render is more than a map of colour: light, parts and the membrane vary over the face. The map F of the skin is the
best single one, and where the matte is 1 it gives nearly the same skin.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import Literal

import numpy as np

from pvg._arrays import Floats
from pvg._targets import check_files, check_folder, check_folder_of_files
from pvg._threads import ahead, one_blas_thread
from pvg.asset import VectorVideo, check_vectorized
from pvg.haze import cleared
from pvg.looks import CUBE_SIZE, Look, check_size, look_cube, remainder_by_luma, write_cube
from pvg.rendering.canvas import Canvas, frame_of_file, stored_canvas
from pvg.rendering.matte_files import MATTES, MatteFormat, MatteWriter, matte_name, matte_writer
from pvg.rendering.passes import Progress
from pvg.rendering.renderer import Renderer
from pvg.video import ColorSpace

SuiteFile = Literal["cube", "matte"]
SUITE_FILES: tuple[SuiteFile, ...] = ("cube", "matte")

_NUMBERED = re.compile(r"\d{6,}\.png")
_WITHIN = 0.9  # of the matte: pixels whose change is all the look's
_README = "look-README.txt"
_NAMED = re.compile(r"((look|matte)(?:-\d+)?(?:\.\w+)?): ")  # how a line there begins: a file, and its stem
_README_CUBE = "{}: the look's colours, a 3D LUT for the clip's own values ({}); put it on a copy of the clip.\n"
_README_MATTE = (
    "{}: where the look lies, white on black, frame by frame as the clip; lay that copy over the clip through it.\n"
)
_README_REST = (
    "Light, make-up of parts, eyes and teeth are in the rendered clip only; "
    "over the face the rest is nearly the same.\n"
)


def export(
    video: VectorVideo,
    look: Look,
    folder: str | Path,
    *,
    parts: Iterable[SuiteFile] = SUITE_FILES,
    matte: MatteFormat = "ffv1",
    size: int = CUBE_SIZE,
    keep: Iterable[str | Path] = (),
    progress: Progress | None = None,
) -> list[Path]:
    """Write a look as files into a folder, made when it is not there; their paths: cubes, mattes, look-README.txt.

    For each person whom the look changes: `look.cube`, a table of `size` nodes a side from the clip's own R'G'B' to new
    ones; and its matte at the clip's size, frame by frame: `matte.mkv`, grey and lossless ("ffv1"), `matte.mov`,
    ProRes 4444 with the matte as alpha too ("prores"), or `matte/000000.png` on ("png", and of a picture always
    `matte.png`). With several persons names end in -1, -2, … And a look-README.txt of some lines. With key frames of
    different exposure the table is that of the one the look was made from. parts: what is made of "cube" and "matte".
    progress: see `render`; a cube alone has none. Files appear under their names only when all are complete. Raises
    `AssetError` and `MediaError` as `render`; before anything is drawn `ValueError` for an unknown part, matte or size,
    a look of another clip or without maps, and files in the place of the clip or asset or of `keep`, further files that
    are not to be replaced; `OSError` where the files cannot be written. What the look-README.txt of an export before
    names of these parts, such as a matte of another kind, and numbered pictures that are left of it are removed.
    """
    check_vectorized(video)
    _check_sequence("parts", parts)
    _check_sequence("keep", keep)
    parts, read = tuple(parts), [video.source, video.path, *map(Path, keep)]  # looked at more than once
    if unknown := [part for part in parts if part not in SUITE_FILES]:
        raise ValueError(f"part {unknown[0]!r} is not one of {', '.join(SUITE_FILES)}")
    if matte not in MATTES:
        raise ValueError(f"matte {matte!r} is not one of {', '.join(MATTES)}")
    check_size(size)
    renderer = Renderer(video, [look])
    canvas = stored_canvas(video)
    folder = Path(folder)
    persons = [[face for face in person if face in look.maps] for person in video.persons]
    persons = [faces for faces in persons if faces]
    if not persons:
        raise ValueError("the look has no map of colour for any face of the clip: there is nothing to export")
    ends = [""] if len(persons) == 1 else [f"-{k + 1}" for k in range(len(persons))]
    cube_names = [f"look{end}.cube" for end in ends] if "cube" in parts else []
    matte_names = [matte_name(end, matte, canvas.info) for end in ends] if "matte" in parts else []
    _check_targets(folder, [*cube_names, *matte_names, _README], read)
    with _made(folder), tempfile.TemporaryDirectory(prefix=".look-", dir=folder) as name:
        drafts = Path(name)
        cubes = [drafts / one for one in cube_names]
        for faces, path in zip(persons, cubes, strict=False):
            write_cube(path, _cube(video, look, renderer, faces, canvas.info.format.color, size), path.stem)
        writers = [matte_writer(drafts, end, matte, canvas.info) for end in ends] if "matte" in parts else []
        if writers:
            _write_mattes(canvas, renderer, persons, writers, progress)
        mattes = [writer.path for writer in writers]
        readme = drafts / _README
        readme.write_text(_readme(cubes, mattes, canvas.info.color), encoding="utf-8")
        former = _former(folder, parts)
        written = [_published(path, folder) for path in (*cubes, *mattes, readme)]
        inputs = [path for path in read if path is not None and path.exists()]
        for path in sorted(former - set(written)):
            _remove(path, inputs)
        return written


def _check_sequence(option: str, given: object) -> None:
    if isinstance(given, (str, Path)) or not isinstance(given, Iterable):
        example = f", such as [{str(given)!r}]" if isinstance(given, (str, Path)) else ""
        raise ValueError(f"{option} must be a sequence of names{example}, not {given!r}")


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """The folder, made where it is not there; what was made and is empty goes when the block fails."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BaseException:
        with suppress(OSError):  # not empty, or gone
            for path in missing:
                path.rmdir()
        raise


def _published(draft: Path, folder: Path) -> Path:
    """The file or folder of files under its name in a folder."""
    target = folder / draft.name
    if not draft.is_dir():
        return draft.replace(target)
    target.mkdir(exist_ok=True)
    names = {path.name for path in draft.iterdir()}
    for name in names:
        (draft / name).replace(target / name)
    for path in _numbered(target):  # of a longer clip before
        if path.name not in names:
            path.unlink()
    return target


def _numbered(folder: Path) -> list[Path]:
    """The numbered pictures of a folder."""
    return [path for path in folder.iterdir() if _NUMBERED.fullmatch(path.name)]


def _former(folder: Path, parts: Sequence[SuiteFile]) -> set[Path]:
    """What an export before has written of these parts, as its look-README.txt names it; nothing without one."""
    try:
        lines = (folder / _README).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return set()
    stems = {"cube": "look", "matte": "matte"}
    made = [stems[part] for part in parts]
    return {folder / one[1] for one in map(_NAMED.match, lines) if one is not None and one[2] in made}


def _remove(path: Path, inputs: Sequence[Path]) -> None:
    """Remove a file, or the numbered pictures of a folder and the folder if it is empty then, but for the inputs."""
    for one in _numbered(path) if path.is_dir() else [path]:
        if one.is_file() and not any(one.samefile(given) for given in inputs):
            one.unlink()
    if path.is_dir():
        with suppress(OSError):  # it has other files
            path.rmdir()


def _check_targets(folder: Path, names: Sequence[str], inputs: Sequence[Path | None]) -> None:
    """Refuse files that cannot be written or would replace one of the inputs; a name without a suffix is a folder's."""
    check_folder(folder)
    if not folder.exists():
        return
    check_files([folder / name for name in names if "." in name], inputs)
    for name in names:
        if "." not in name:
            check_folder_of_files(folder / name, inputs)


def _write_mattes(
    canvas: Canvas,
    renderer: Renderer,
    persons: list[list[int]],
    writers: Sequence[MatteWriter],
    progress: Progress | None,
) -> None:
    """The matte of each person, in one reading of the clip."""
    with one_blas_thread(), ExitStack() as stack:
        for writer in writers:
            stack.enter_context(writer)
        frames = stack.enter_context(closing(ahead(canvas.frames())))
        for frame in frames:
            for alpha, writer in zip(renderer.mattes(frame, 0, persons), writers, strict=True):
                writer.write(frame, alpha)
            if progress is not None:
                progress("render", frame.index + 1, renderer.video.frame_count)


def _readme(cubes: list[Path], mattes: list[Path], color: str) -> str:
    """How to use the files: of each person a line for each, and at the end one of what a cube is not."""
    lines = []
    for k in range(max(len(cubes), len(mattes))):
        lines += [_README_CUBE.format(cubes[k].name, color)] if cubes else []
        lines += [_README_MATTE.format(mattes[k].name)] if mattes else []
    return "".join([*lines, *([_README_REST] if cubes else [])])


def _cube(
    video: VectorVideo, look: Look, renderer: Renderer, faces: Sequence[int], space: ColorSpace | None, size: int
) -> Floats:
    """The best single map of a person's faces: F, and by luma what the drawn key frame has besides."""
    # the key frame whose light is nearest to that of the one F was made from
    _, face, k = min(
        (float(np.abs(np.log([gain, *tint])).sum()), face, k)
        for face in faces
        for k, (gain, _, *tint) in enumerate(look.maps[face].exposures)
    )
    one, key = look.maps[face], video.records[face].key_frames[k].frame
    frame = frame_of_file(video, key)
    (drawn,) = renderer.draw(frame)
    (matte,) = renderer.mattes(frame, 0, [[face]])
    skin = matte > _WITHIN
    before, after = (cleared(np.asarray(picture.rgb()[skin], np.float64), one.haze) for picture in (frame, drawn))
    lacks = remainder_by_luma(one.skin, one.strength, before, after) if skin.any() else None
    return look_cube(one.skin, one.strength, space, size, lacks, haze=one.haze)
