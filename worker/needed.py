"""The media that looks are made of: which a job needs, whether they are ready, and what of their files is lost."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

from sqlalchemy.orm import Session

from service.catalog import Job, JobKind, Look, Media, jobs, look_params, media
from service.catalog.requests import no_face
from service.storage import BlobMissingError
from worker.answers import VerifyAnswer, checked
from worker.failures import LostAssetsError, OptionError, SourceLostError, UnreadyError, without_files
from worker.lease import LeaseLostError
from worker.run import Run
from worker.sandbox import MethodError


def wanted(run: Run) -> tuple[list[Look], dict[str, Media]]:
    """The looks to make, of the whole job, and the media they need.

    Raises `LeaseLostError` when one was deleted, `UnreadyError` when one is to be waited for again, and `OptionError`
    for a face that is not there.
    """
    looks, known, unready = run.read(lambda session: _known(session, run.job))
    present = {media_id: medium for media_id, medium in known.items() if medium is not None}
    if len(present) < len(known):  # the lease was revoked with it
        raise LeaseLostError
    if unready:
        raise UnreadyError(unready)
    if run.job.parent_id is None:  # else it was looked at before the job was cut into parts
        for look in looks:
            _check_faces(JobKind(run.job.kind), look, present)
    return looks, present


def _check_faces(kind: JobKind, look: Look, present: dict[str, Media]) -> None:
    """Raise `OptionError`, which says where, for a face that nobody knew to be missing when the look was asked for."""
    params, place = look_params(look), jobs.look_place(kind, look)
    chosen = () if params.faces == "all" else params.faces
    wanted_of = {"faces": (look.video_id, "clip", chosen)}
    if params.reference_face is not None:
        wanted_of["reference_face"] = (look.reference_id, "reference", (params.reference_face,))
    for name, (media_id, what, faces) in wanted_of.items():
        count = len(present[media_id].faces)
        if count and (missing := [face for face in faces if face >= count]):
            raise OptionError(no_face(missing[0], count, f"this {what}"), f"{place}/{name}")


def _known(session: Session, job: Job) -> tuple[list[Look], dict[str, Media | None], set[str]]:
    looks = jobs.looks(session, job.parent_id or job.id)
    ids = {media_id for look in looks for media_id in (look.video_id, look.reference_id)}
    found = {media_id: media.get(session, media_id) for media_id in ids}
    return looks, found, media.unready(session, job, [one for one in found.values() if one is not None])


@contextmanager
def telling_what_is_lost(run: Run, present: dict[str, Media]) -> Iterator[None]:
    """When the block fails for it, raise `SourceLostError` or `LostAssetsError` of those of these media whose files
    are gone or cannot be read, or whose assets an earlier vectoriser made.
    """
    try:
        yield
    except BlobMissingError as error:
        _say_what_is_lost(run, present, error)
        raise
    except MethodError as error:
        if error.kind == "AssetError":
            _say_what_is_lost(run, present, error)
        raise without_files(error, present.values(), run.keys) from error


def _say_what_is_lost(run: Run, present: dict[str, Media], error: Exception) -> None:
    """Raise what is lost of these media, if anything.

    One that was deleted meanwhile may be told as lost: the lease was revoked with it, so nothing comes of that.
    """
    for medium in present.values():
        if not run.patience(partial(run.storage.exists, medium.source_key)):
            raise SourceLostError(medium.id) from error
    remade = made_since(run, list(present.values()))
    lost = {
        medium.id: medium.asset_key
        for medium in present.values()
        if not _is_usable(run, medium, remade=medium.id in remade)
    }
    if lost:
        raise LostAssetsError(lost) from error


def _is_usable(run: Run, medium: Media, *, remade: bool) -> bool:
    try:
        with ExitStack() as stack:
            asset = asset_of(run, stack, medium)
            arguments = {"asset": str(asset), "remade": [str(asset)] if remade else []}
            found = run.call("verify", arguments, read=[asset], folder=run.draft_folder())
    except BlobMissingError:
        return False
    return checked(VerifyAnswer, found).usable


def made_since(run: Run, of: Sequence[Media]) -> set[str]:
    """The ids of those that were vectorised for this job, or since. They are taken as they are: while workers of two
    versions run, an earlier one may have made them.
    """
    return run.read(lambda session: media.made_since_asked(session, run.job, of))


def asset_of(run: Run, stack: ExitStack, medium: Media) -> Path:
    """The file of a medium's asset, there until the stack is closed."""
    assert medium.asset_key is not None  # noqa: S101 - a job is released only when its media are ready
    return stack.enter_context(run.local_path(medium.asset_key))
