"""A vectorize job: source -> asset."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from service.catalog import Asset, Media, Pictures, Role, media, vectorize_request
from service.storage import BlobMissingError
from worker.answers import FaceAnswer, OutputAnswer, PictureAnswer, VectorizeAnswer, checked, made
from worker.failures import SourceLostError, without_paths
from worker.lease import LeaseLostError
from worker.run import Run
from worker.sandbox import CrashError, MethodError
from worker.unpublished import Unpublished

#: part of the job that each stage of the vectoriser takes; storing takes the rest
CLIP_SPANS = {"vectorize": (0.0, 0.9), "second reading": (0.9, 0.97)}  # few clips need a second reading
REFERENCE_SPANS = {"landmarks": (0.0, 0.6), "best frame": (0.6, 0.9)}
_ASSET = "asset.pvg"
_PICTURES = "pictures.jpgs"


def vectorize(run: Run) -> bool:
    """Do the job. False when its lease was lost at the end, and nothing was published."""
    media_id = run.job.media_id
    assert media_id is not None  # noqa: S101 - every job of this kind has one
    medium = run.read(lambda session: media.get(session, media_id))
    if medium is None:  # deleted, and the lease was revoked with it
        raise LeaseLostError
    folder = run.draft_folder()
    try:
        with run.local_path(medium.source_key) as source, run.timed("vectorize_s"):
            answer = _vectorize(run, source, folder)
    except BlobMissingError as error:
        raise SourceLostError(medium.id) from error
    return _publish(run, medium, folder, answer)


def _publish(run: Run, medium: Media, folder: Path, answer: VectorizeAnswer) -> bool:
    """Store what was made, and end the job with it. False when its lease was lost: nothing was published."""
    with Unpublished(run) as unpublished:
        name = unpublished.own(medium.id)
        with run.timed("store_s"):
            file = unpublished.store("asset", made(folder, _ASSET), name, ".pvg")
            small = made(folder, _PICTURES)
            spans = _spans(answer.pictures, small.stat().st_size)
            pictures = unpublished.store("pictures", small, name, ".jpgs")
        faces, warnings = _faces(answer.faces)
        shown = answer.media.model_dump(exclude={"warnings"})
        lines = [*answer.media.warnings, *warnings, *_of_the_file(answer.output)]
        size = file.size_bytes + pictures.size_bytes
        asset = Asset(file.key, size, shown, faces, lines, Pictures(pictures.key, spans))
        unneeded = unpublished.record(lambda: _finish(run, asset))
    if unneeded is None:
        return False
    run.blobs.delete(unneeded)
    return True


def _spans(said: list[PictureAnswer], size: int) -> list[list[int | None]]:
    """Where the small pictures are in their file of so many bytes."""
    if any(not one.start < one.end <= size for one in said):
        raise CrashError("its process told of pictures that it did not make")
    return [[one.face, one.start, one.end] for one in said]


def _finish(run: Run, asset: Asset) -> list[str] | None:
    with run.database.write() as session:
        now, media_id = run.database.now(), str(run.job.media_id)
        unneeded = media.finish(session, run.lease, asset, now=now, timings=run.timings)
        if unneeded is None:  # unless it was finished by a call whose answer was lost
            medium = media.get(session, media_id)
            return [] if medium is not None and medium.asset_key == asset.key else None
        media.use(media.locked(session, [media_id]), now=now, ttl_s=run.settings.media_ttl_s)
        return unneeded


def _vectorize(run: Run, source: Path, folder: Path) -> VectorizeAnswer:
    request = vectorize_request(run.job)
    is_reference = request.role is Role.REFERENCE
    run.progress.expect(REFERENCE_SPANS if is_reference else CLIP_SPANS)
    arguments = {
        "source": str(source),
        "asset": str(folder / _ASSET),
        "pictures": str(folder / _PICTURES),
        "options": {
            "reference": is_reference,
            **asdict(request.settings),
            "min_face_px": run.settings.min_face_px,
            "advised_face_px": run.settings.warn_face_px,
        },
    }
    try:
        return checked(VectorizeAnswer, run.call("vectorize", arguments, read=[source], folder=folder))
    except MethodError as error:
        # the blob's name means nothing to the client, and the file's own stays with its medium: what is said here is
        # kept with jobs and in the log when that is deleted
        raise error.saying(without_paths(str(error), {source: "the file"})) from error


def _of_the_file(output: OutputAnswer | None) -> list[str]:
    """What an mp4 made of a clip, or a png of a picture, does not keep of its file, or why there can be none."""
    if output is None:
        return []
    lines = [output.refused] if output.refused is not None else output.lost
    return [f"in {_ARTICLES[output.container]}: {line}" for line in lines]


_ARTICLES = {"mp4": "an mp4", "png": "a png"}


def _faces(found: list[FaceAnswer]) -> tuple[list[dict[str, object]], list[str]]:
    """What is shown of each face, and the warnings of all."""
    warnings = [f"face {face.index}: {warning}" for face in found for warning in face.warnings]
    return [face.model_dump() for face in found], warnings
