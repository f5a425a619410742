"""The `pvg` command. Exit codes: 0 done; 2 bad arguments; 3 bad input, with one line that says what and where."""

from __future__ import annotations

import argparse
import json
import signal
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import pvg
from pvg._options import parser_of
from pvg._outputs import (
    check_asset_name,
    check_coding,
    check_outputs,
    check_pipe,
    check_results_folder,
    check_suffix,
    kind_of,
    outputs,
    suffix,
)
from pvg._parsed_options import (
    check_clip_options,
    check_codings,
    check_inputs,
    check_reading,
    check_source,
    is_asset,
    look_options,
    not_default,
    output_options,
    reading_options,
)
from pvg._targets import STANDARD, check_file
from pvg._terminal import (
    EndedError,
    end_quietly,
    ended_by_signals,
    fail,
    mend_streams,
    print_warnings,
    progress_bars,
    warn_of_faces,
)
from pvg.errors import AssetError, PvgError

if TYPE_CHECKING:
    from pvg.asset import FaceSummary, VectorVideo
    from pvg.looks import Look

BAD_ARGUMENTS = 2
BAD_INPUT = 3


def _open_input(
    path: Path,
    stack: ExitStack,
    *,
    reading: Mapping[str, Any] | None = None,
    source: Path | None = None,
    drawn: bool = True,
) -> VectorVideo:
    """An asset as it is; a clip or image is vectorised into a temporary asset.

    reading: how it is read, None for a reference. drawn: its own clip is drawn on.
    """
    reference = reading is None
    if is_asset(path):
        opened = stack.enter_context(pvg.open_asset(path, source))
        if drawn and not reference and opened.source is None:
            name = opened.manifest.get("source_name", "the clip")
            raise AssetError(
                f"{path.name} is drawn on {name}, which it was made from: put that beside it or say --source"
            )
        return opened
    with progress_bars() as progress:
        opened = stack.enter_context(pvg.vectorize(path, reference=reference, progress=progress, **reading or {}))
    print_warnings(path, opened.media.warnings)
    return opened


def _chosen(video: VectorVideo, faces: Literal["all"] | Sequence[int]) -> list[FaceSummary]:
    return [face for face in video.faces if faces == "all" or face.index in faces]


def _vectorize(given: argparse.Namespace) -> None:
    if given.output == STANDARD:
        raise ValueError("an asset cannot be written to a pipe; name a file, as clip.pvg")
    check_asset_name(given.output)
    with progress_bars() as progress:
        video = pvg.vectorize(
            given.input,
            asset=given.output,
            mask=given.mask,
            matching=given.matching,
            progress=progress,
            **reading_options(given),
        )
    with video:
        print_warnings(given.input, video.media.warnings)
        warn_of_faces(given.input, video.faces)
    print(given.output)


def _warn_of_outputs(
    paths: Iterable[Path], warnings: Iterable[Sequence[str]], printed: Iterable[Sequence[str]]
) -> None:
    """Say on standard error, a line each, what of each output is not as in its clip and was not printed before."""
    for path, lines, before in zip(paths, warnings, printed, strict=True):
        print_warnings(path, [line for line in lines if line not in before])


def _printed_for(path: Path, video: VectorVideo) -> Sequence[str]:
    """The warnings that `_open_input` has printed for an input."""
    return () if is_asset(path) else video.media.warnings


def _transfer(given: argparse.Namespace) -> None:
    piped = given.output == STANDARD
    check_source(given, piped=True)
    source = None if given.source == STANDARD else given.source
    check_reading(given, given.input)
    if piped:
        check_pipe(given.container, given.reference)
    else:
        check_outputs(given.output, given.reference, [given.input, source, *given.reference], given.container)
    single = None if len(given.reference) > 1 or given.output.is_dir() else given.output
    check_codings(given, [given.input], single)
    with ExitStack() as stack:
        clip = _open_input(
            given.input, stack, reading=reading_options(given), source=source, drawn=given.source != STANDARD
        )
        check_clip_options(given, clip.media.kind)
        if is_asset(given.input) and given.source != STANDARD:
            color = clip.settings["input_color"]
            check_coding(clip.require_source(), clip.media.kind, single, output_options(given), input_color=color)
        references = [_open_input(path, stack) for path in given.reference]
        looks = [_look(given, clip, reference) for reference in references]
        paths = [STANDARD] if piped else outputs(given.output, given.reference, clip, given.container)
        for path in [] if piped else paths:
            check_file(path, [clip.source, given.input, *given.reference])
        warn_of_faces(given.input, _chosen(clip, given.face))
        for path, reference in zip(given.reference, references, strict=True):
            warn_of_faces(path, [_reference_face(reference, given.reference_face)])
        pictures = sys.stdin.buffer if given.source == STANDARD else None
        targets = [sys.stdout.buffer] if piped else paths
        with progress_bars() as progress:
            warnings = pvg.render(clip, looks, targets, pictures=pictures, progress=progress, **output_options(given))
        printed = [_printed_for(given.input, clip)] * len(looks)
    _warn_of_outputs([Path("standard output")] if piped else paths, warnings, printed)
    if not piped:
        print(*paths, sep="\n")


def _look(given: argparse.Namespace, clip: VectorVideo, reference: VectorVideo) -> Look:
    return pvg.transfer(
        clip,
        reference,
        contrast=given.contrast,
        faces=given.face,
        reference_face=given.reference_face,
        **look_options(given),
    )


def _export(given: argparse.Namespace) -> None:
    check_source(given)
    check_reading(given, given.input)
    check_results_folder(given.output, "a look's files")
    with ExitStack() as stack:
        clip = _open_input(given.input, stack, reading=reading_options(given), source=given.source)
        reference = _open_input(given.reference, stack)
        warn_of_faces(given.input, _chosen(clip, given.face))
        warn_of_faces(given.reference, [_reference_face(reference, given.reference_face)])
        with progress_bars() as progress:
            written = pvg.export(
                clip,
                _look(given, clip, reference),
                given.output,
                matte=given.matte,
                keep=[given.input, given.reference],
                progress=progress,
            )
    print(*written, sep="\n")


def _reference_face(reference: VectorVideo, face: int | None) -> FaceSummary:
    from pvg.looks import reference_face_of  # noqa: PLC0415

    return reference_face_of(reference, face)


def _swap(given: argparse.Namespace) -> None:
    a, b = given.a, given.b
    check_reading(given, *([a] if b is None else [a, b]))
    if b is None:
        if given.faces is None:
            raise ValueError("give a second clip, or two faces of the one: --faces 0,1")
        _swap_within(given)
        return
    check_results_folder(given.output, "both results")
    if a.exists() and b.exists() and a.samefile(b):
        raise ValueError("a clip cannot be swapped with itself; give it alone, with two faces: --faces 0,1")
    if given.faces is not None:
        raise ValueError("--faces is for a swap within one clip; leave out one of the two")
    _swap_clips(given, a, b, given.output)


def _swap_within(given: argparse.Namespace) -> None:
    """Two faces of one clip."""
    check_outputs(given.output, [given.a], [given.a], given.container)
    check_codings(given, [given.a], None if given.output.is_dir() else given.output)
    with ExitStack() as stack:
        clip = _open_input(given.a, stack, reading=reading_options(given))
        check_clip_options(given, clip.media.kind)
        (path,) = outputs(given.output, [given.a], clip, given.container)
        check_suffix(path, [clip.media.kind])
        look = pvg.exchange(clip, given.faces, contrast=given.contrast, **look_options(given))
        warn_of_faces(given.a, _chosen(clip, given.faces))
        with progress_bars() as progress:
            warnings = pvg.render(clip, [look], [path], progress=progress, **output_options(given))
        printed = _printed_for(given.a, clip)
    _warn_of_outputs([path], warnings, [printed])
    print(path)


def _swap_clips(given: argparse.Namespace, a: Path, b: Path, folder: Path) -> None:
    """Two clips."""
    check_codings(given, [a, b], None)
    with ExitStack() as stack:
        first, second = (_open_input(path, stack, reading=reading_options(given)) for path in (a, b))
        check_clip_options(given, first.media.kind, second.media.kind)
        if first.source_sha256 == second.source_sha256:
            raise ValueError(f"{a.name} and {b.name} are the same clip; give one alone, with two faces: --faces 0,1")
        same = a.stem == b.stem
        paths = [
            folder / f"{a.stem}{'-a' if same else ''}{suffix(first.media.kind, given.container)}",
            folder / f"{b.stem}{'-b' if same else ''}{suffix(second.media.kind, given.container)}",
        ]
        folder.mkdir(parents=True, exist_ok=True)
        warn_of_faces(a, first.faces)
        warn_of_faces(b, second.faces)
        with progress_bars() as progress:
            warnings = pvg.swap(
                first,
                second,
                paths,
                contrast=given.contrast,
                progress=progress,
                **look_options(given),
                **output_options(given),
            )
        printed = [_printed_for(a, first), _printed_for(b, second)]
    _warn_of_outputs(paths, warnings, printed)
    print(*paths, sep="\n")


def _inspect(given: argparse.Namespace) -> None:
    if (given.layer is None) != (given.output is None):
        raise ValueError("--layer and -o go together")
    if given.frame is not None and given.layer is None:
        raise ValueError("--frame is of a --layer")
    if given.output is not None:
        check_suffix(given.output, ["image"])
        check_file(given.output, [given.input, given.source])
    check_source(given)
    check_reading(given, given.input)
    if not is_asset(given.input):
        if given.layer is not None:
            raise ValueError(f"a layer is drawn of an asset, which {given.input.name} is not; vectorise it first")
        check_clip_options(given, kind_of(given.input))
        asked = {"container": given.container, "codec": given.codec, "audio": given.audio}
        found = pvg.inspect(given.input, **asked, **reading_options(given))
        print(json.dumps(found, indent=2, ensure_ascii=False))
        return
    if unused := not_default(given, "container", "codec", "audio"):
        raise ValueError(f"--{unused[0]} is of an output of a clip or picture, and {given.input.name} is an asset")
    with pvg.open_asset(given.input, given.source) as video:
        if given.layer is None:
            print(json.dumps(video.summary(), indent=2))
            return
        frame = given.frame or 0
        if not 0 <= frame < video.frame_count:
            raise ValueError(f"no frame {frame}: the clip has {video.frame_count} frames, from 0")
        from pvg.video import write_image  # noqa: PLC0415

        write_image(given.output, pvg.layer(video, frame, given.layer))
    print(given.output)


def _models(given: argparse.Namespace) -> None:
    from pvg.models import MODELS, cache_folder, install  # noqa: PLC0415

    state = "installed" if install(folder=given.folder) else "already there"
    print(f"{len(MODELS)} networks {state} in {cache_folder()}")


_COMMANDS = {
    "vectorize": _vectorize,
    "transfer": _transfer,
    "swap": _swap,
    "export": _export,
    "inspect": _inspect,
    "models": _models,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command and turn the library's errors into exit codes."""
    mend_streams()
    parser = parser_of(_COMMANDS)
    if not (sys.argv[1:] if arguments is None else arguments):
        parser.print_help(sys.stderr)
        sys.exit(BAD_ARGUMENTS)
    given = parser.parse_args(arguments)
    try:
        with ended_by_signals():
            check_inputs(given)
            given.run(given)
            sys.stdout.flush()
    except BrokenPipeError:
        end_quietly()
    except PvgError as error:
        fail(BAD_INPUT, str(error))
    except OSError as error:
        where = f": {error.filename}" if error.filename is not None else ""
        fail(BAD_INPUT, f"{error.strerror or error}{where}")
    except ValueError as error:
        fail(BAD_ARGUMENTS, str(error))
    except KeyboardInterrupt as error:
        sys.exit(128 + (error.number if isinstance(error, EndedError) else signal.SIGINT))


if __name__ == "__main__":
    main()
