"""Algorithm 1, precomputation: a clip or an image becomes a `VectorVideo`.

One reading of the clip, frames streamed: decoding, the landmarks some dozens of frames ahead, and then the skin and its
boundary in every frame and the boundary colours in the key frames, each in a thread of its own. The Poisson regions
need no storing: f_i is the Laplacian of the clip itself. Here the options are checked and the asset is put together;
`whole_clip` and `references` do the work between.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, get_args

from pvg._checks import check_switch, check_word, real_number, whole_number
from pvg._targets import check_file
from pvg._threads import one_blas_thread, one_opencv_thread
from pvg.asset import AssetWriter, MediaSummary, VectorVideo, source_note
from pvg.curves import Matching
from pvg.errors import MediaError
from pvg.landmarks import link_persons
from pvg.skin import MaskMethod
from pvg.vectorization.face_maker import FaceMaker, FoundFaces
from pvg.vectorization.face_messages import no_skin_anywhere, no_skin_warning
from pvg.vectorization.references import BEST_FRAME, LANDMARKS, write_reference
from pvg.vectorization.shared_threads import SharedThreads
from pvg.vectorization.source_reader import Progress, SourceReader, StoppedByCallerError
from pvg.vectorization.vector_face import ADVISED_FACE_PX, VectorFace
from pvg.vectorization.whole_clip import SECOND_READING, VECTORIZE, follow_all_faces
from pvg.video import INPUT_COLORS, FileState, InputColor, MediaLimits, file_state, probe, sha256_file

VECTORIZER_VERSION = 36  # raised when the same clip would give another asset
MIN_FACE_PX = 64
_WIDEST_PX = 65_535  # no picture has more
STAGES = (VECTORIZE, SECOND_READING, LANDMARKS, BEST_FRAME)  # of the progress callback, in their order


def vectorize(
    source: str | Path,
    *,
    asset: str | Path | None = None,
    reference: bool = False,
    mask: MaskMethod = "landmarks",
    matching: Matching = "table",
    input_color: InputColor = "auto",
    limits: MediaLimits | None = None,
    progress: Progress | None = None,
    min_face_px: float = MIN_FACE_PX,
    advised_face_px: float = ADVISED_FACE_PX,
    seed: int = 0,
    strict: bool = False,
) -> VectorVideo:
    """Vectorise a clip or an image, once for all looks.

    asset: where the asset file is written; a temporary file that goes with the object when None.
    reference: keep only what a reference needs: all faces of an image; of a clip the best frame of the largest face in
    its first 300 frames, or in all of it where none of those is wide enough.
    mask: "landmarks" (default) or "ycbcr", the paper's rule.  matching: "table" maps every frame straight to the key
    frame's colours; "chain" is the paper's frame-to-frame way with new key frames every 120 frames.
    input_color: how the clip is coded: "auto" believes its tags, of HDR too; camera logarithms, which files do not
    name, are "slog3", "logc3", "logc4", "vlog", "applelog"; "sdr", "pq" and "hlg" stand for wrong or missing tags.
    progress: called as (stage, frames done, frames expected) with one of STAGES; what it raises ends the work and
    passes through. The stage is "vectorize", and of a clip "second reading" too if a track needs one; a reference that
    is a clip has "landmarks" and "best frame", one that is a picture none.
    limits: what is accepted, whenever the clip is read; to `open_asset` they are said again.
    min_face_px: of faces that are followed;  advised_face_px: narrower ones get a warning;  seed: of the pixels that
    the least-squares fit draws.  strict: a clip whose end is cut off, whose colour tags or range change, or that goes
    on interlaced, is refused; else its frames up to there are used, and all are read as the first one, with a warning.
    Raises `MediaError` (not a video or image, damaged, over a limit, or changed meanwhile), `NoFaceError`, and
    `FaceTooSmallError` when every face is narrower than `min_face_px`. Before any frame is read: `ValueError` for an
    option that is none of these and for an asset in the place of the source, `OSError` where the asset cannot be
    written. A file that is there is replaced by a whole asset only.
    """
    path = Path(source)
    _check_options(mask, matching, input_color, reference=reference, strict=strict)
    min_face_px = real_number("min_face_px", min_face_px, 0, _WIDEST_PX)
    advised_face_px = real_number("advised_face_px", advised_face_px, 0, _WIDEST_PX)
    seed = whole_number("seed", seed)
    if asset is not None:
        check_file(Path(asset), [path])
    before = _state_of(path)
    media = probe(path, limits, input_color=input_color, strict=strict)
    reader = SourceReader(path, media, limits, input_color, strict, progress or (lambda stage, done, total: None))
    with (
        one_blas_thread(),
        one_opencv_thread() if media.kind == "video" and not reference else contextlib.nullcontext(),
        _temporary_name() if asset is None else contextlib.nullcontext(Path(asset)) as target,
        SharedThreads() as threads,
        AssetWriter(target) as writer,
    ):
        maker = FaceMaker(mask, matching, seed, min_face_px, advised_face_px, threads)
        try:
            found = (write_reference if reference else follow_all_faces)(reader, maker, writer)
        except StoppedByCallerError as stopped:
            raise stopped.error from None
        faces, skinless = _with_skin(found, path.name, mask, writer)
        _add_faces(faces, writer)
        settings = {"mask": mask, "matching": matching, "reference": reference, "seed": seed}
        writer.finish(
            {
                "vectorizer": VECTORIZER_VERSION,
                "settings": {**settings, "input_color": input_color},
                **source_note(path, None if asset is None else target),
                "source_sha256": _sha256_of(path, before),
                "media": _media(reader, found, skinless),
                "shots": list(found.shots),
            }
        )
    return VectorVideo(target, path, limits=limits, temporary=asset is None)


def _state_of(path: Path) -> FileState | None:
    """`file_state`; None where it cannot be had, as `probe` explains."""
    try:
        return file_state(path)
    except (OSError, ValueError):
        return None


def _sha256_of(path: Path, before: FileState | None) -> str:
    """The clip's sha256, by which the asset is held to be of it.

    before: its state before any of it was read. Raises `MediaError` when it is another now: the bytes that are hashed
    may not be those that were read.
    """
    sha256 = sha256_file(path)
    if _state_of(path) != before:
        raise MediaError(f"{path.name} was changed while it was read; vectorise it once it stays as it is")
    return sha256


def _check_options(mask: str, matching: str, input_color: str, **switches: bool) -> None:
    for name, value, known in (
        ("mask", mask, get_args(MaskMethod)),
        ("matching", matching, get_args(Matching)),
        ("input_color", input_color, INPUT_COLORS),
    ):
        check_word(name, value, known)
    for name, switch in switches.items():
        check_switch(name, switch)


@contextlib.contextmanager
def _temporary_name() -> Iterator[Path]:
    """A name that nobody else has; what is there goes when the block is left by an exception."""
    handle, name = tempfile.mkstemp(suffix=".pvg")
    try:
        os.close(handle)
        yield Path(name)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def _with_skin(
    found: FoundFaces, name: str, mask: MaskMethod, writer: AssetWriter
) -> tuple[list[VectorFace], tuple[str, ...]]:
    """The faces whose mask finds skin, by first frame and from left to right, and a warning for each of the others.

    What was written of those is dropped.  name: of the clip's file. Raises `NoFaceError` when none is left.
    """
    faces = sorted(found.faces, key=lambda face: (face.first, face.left_to_right))
    skinless = [face for face in faces if not face.has_skin()]
    if len(skinless) == len(faces):
        raise no_skin_anywhere(name, len(faces), mask)
    for face in skinless:
        writer.drop_track(face.number)
    warnings = tuple(no_skin_warning(face.first, mask) for face in skinless)
    return [face for face in faces if face not in skinless], warnings


def _add_faces(faces: Sequence[VectorFace], writer: AssetWriter) -> None:
    """Write the faces in their order, each with the person it is."""
    records = [face.record(index) for index, face in enumerate(faces)]
    persons = link_persons([face.shape() for face in faces], [record.summary.skin_rgb for record in records])
    for face, record, person in zip(faces, records, persons, strict=True):
        writer.add_face(replace(record, summary=replace(record.summary, person=person)), face.number)


def _media(reader: SourceReader, found: FoundFaces, warnings: tuple[str, ...]) -> dict[str, Any]:
    """The manifest's entry of the clip;  warnings: beside those of its file and of its reading."""
    summary = MediaSummary.of(reader.media, found.frame_count)
    return {**asdict(summary), "warnings": summary.warnings + tuple(dict.fromkeys(reader.notices)) + warnings}
