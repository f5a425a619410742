"""The use cases: what a request makes of the records, the files and the queue."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from service.api.schemas import CLIP_CONTAINERS, IMAGE_CONTAINERS, Contrast, LookOptions, OutputRequest
from service.api.services import Services
from service.api.uploads import ReceivedFile
from service.catalog import (
    DEFAULT_VECTOR_SETTINGS,
    Job,
    JobKind,
    LookParams,
    Media,
    MediaState,
    Message,
    NewLook,
    OutputOptions,
    RenderRequest,
    Role,
    Upload,
    VectorSettings,
    jobs,
    media,
)
from service.errors import ConflictError, MediaFailedError, NotFoundError, ValidationFailedError
from service.ids import new_id

_TRIES = 3


def register(
    services: Services, role: Role, file: ReceivedFile, vector: VectorSettings = DEFAULT_VECTOR_SETTINGS
) -> tuple[Media, bool]:
    """Record a received file. Returns its medium, and True when there is a vectorisation to wait for because of it.

    The same bytes in the same role, vectorised with the same settings, are the same medium; one that failed is
    vectorised again.
    """
    for _ in range(_TRIES):
        known = _known(services, role, file.sha256, vector)
        if known is not None:
            return known
        created = _create(services, role, file, vector)
        if created is not None:
            return created, True
    raise ConflictError("this file is being uploaded and deleted at the same time; try again")


def _known(services: Services, role: Role, sha256: str, vector: VectorSettings) -> tuple[Media, bool] | None:
    settings, now = services.settings, services.database.now()
    with services.database.read() as session:
        if media.find_content(session, role, sha256, vector) is None:
            return None
    with services.database.write() as session:
        found = media.find_content(session, role, sha256, vector, lock=True)
        if found is None:
            return None
        again = media.vectorize_again(session, found, now=now)
        media.keep(session, [found.id], now=now, ttl_s=settings.media_ttl_s)
        session.flush()
        session.refresh(found)
    if again:
        services.publisher.publish([Message(found.job_id, JobKind.VECTORIZE.value)])
    return found, again


def _create(services: Services, role: Role, file: ReceivedFile, vector: VectorSettings) -> Media | None:
    """Store the bytes and record them; None when another request recorded the same bytes first."""
    media_id = new_id("vid" if role is Role.VIDEO else "ref")
    key = services.storage.key("source", file.sha256, media_id, file.kind.suffix)
    upload = Upload(
        media_id=media_id,
        role=role,
        sha256=file.sha256,
        size_bytes=file.size_bytes,
        content_type=file.kind.content_type,
        filename=file.filename,
        source_key=key,
        settings=vector,
    )
    draft = file.path.with_suffix(".publish")
    # the draft keeps its name as well, in case another request wins and the bytes are needed again
    draft.hardlink_to(file.path)
    try:
        services.storage.put(draft, key)
        with services.database.write() as session:
            created = media.create(session, upload, now=services.database.now(), ttl_s=services.settings.media_ttl_s)
    except IntegrityError:
        services.storage.delete(key)
        return None
    except BaseException:
        draft.unlink(missing_ok=True)
        services.storage.delete(key)
        raise
    services.publisher.publish([Message(created.job_id, JobKind.VECTORIZE.value)])
    return created


@dataclass(frozen=True)
class Wanted:
    """One look that a request asks for.

    ``place`` is where in the request its options stand, as a JSON pointer. With ``exchange`` two faces of the video
    exchange their colours, with a contrast for each.
    """

    video_id: str
    reference_id: str
    options: LookOptions
    place: str
    exchange: tuple[Contrast, Contrast] | None = None


def check_looks(services: Services, looks: Sequence[Wanted], output: OutputRequest, pointers: dict[str, str]) -> None:
    """Raise what `request_looks` would raise for a transfer, and record nothing."""
    with services.database.read() as session:
        _check(session, looks, output, pointers)


def request_looks(
    services: Services,
    kind: JobKind,
    looks: Sequence[Wanted],
    output: OutputRequest,
    pointers: dict[str, str],
) -> Job:
    """Record a job that makes these looks and publish it once its media are ready.

    ``pointers`` says where in the request each id stands, for errors. Raises `NotFoundError` for an unknown id,
    `MediaFailedError` for a medium that failed, `ValidationFailedError` for what does not fit the video.
    """
    database = services.database
    with database.write() as session:
        _check(session, looks, output, pointers)
        if kind is JobKind.SWAP:
            _check_apart(session, looks[0])
        job = jobs.create(
            session,
            kind,
            request=RenderRequest(_output_options(output)),
            now=database.now(),
            outputs=[NewLook(look.video_id, look.reference_id, _params(look)) for look in looks],
        )
        media.keep(session, list(pointers), now=database.now(), ttl_s=services.settings.media_ttl_s)
    # a second transaction: it sees a medium that became ready while the first one ran
    with database.write() as session:
        released = jobs.release(session, now=database.now(), job_id=job.id)
    services.publisher.publish(released)
    return job


def _params(look: Wanted) -> LookParams:
    options = look.options
    return LookParams(
        strength=options.strength,
        contrast=look.exchange or options.contrast,
        match=options.match,
        protect=tuple(options.protect),
        faces=options.faces if options.faces == "all" else tuple(options.faces),
        makeup=options.makeup if isinstance(options.makeup, float) else options.makeup.model_dump(),
        light=options.light,
        extent=options.extent,
        reference_face=options.reference_face,
        beta=options.beta,
        iterations=options.iterations,
        seed=options.seed,
        exchange=look.exchange is not None,
    )


def _output_options(output: OutputRequest) -> OutputOptions:
    return OutputOptions(
        container=output.container,
        codec=output.codec,
        crf=output.crf,
        preset=output.preset,
        audio=output.audio,
    )


def _check(session: Session, looks: Sequence[Wanted], output: OutputRequest, pointers: dict[str, str]) -> None:
    known = {media_id: _usable(session, media_id, pointers) for media_id in pointers}
    for look in looks:
        _check_video(known[look.video_id], look, output, pointers[look.video_id])
        _check_reference(known.get(look.reference_id), look)


def _usable(session: Session, media_id: str, pointers: dict[str, str]) -> Media:
    found = media.get(session, media_id, lock="share")
    if found is None:
        where = pointers[media_id]
        detail = f"there is no {'video' if media_id.startswith('vid') else 'reference'} {media_id}"
        raise NotFoundError(detail, errors=[{"pointer": where, "detail": detail}])
    if found.state == MediaState.FAILED and found.error is not None:
        raise MediaFailedError(found.error, pointers[media_id])
    return found


def _check_video(video: Media, look: Wanted, output: OutputRequest, where: str) -> None:
    if video.role != Role.VIDEO:
        detail = f"{video.id} is a reference; upload the file to /videos to change its colours"
        raise ValidationFailedError(detail, errors=[{"pointer": where, "detail": detail}])
    is_image = video.content_type.startswith("image/")
    allowed = IMAGE_CONTAINERS if is_image else CLIP_CONTAINERS
    if output.container is not None and output.container not in allowed:
        detail = f"{video.id} is {'an image' if is_image else 'a clip'}: the container must be one of "
        detail += ", ".join(allowed)
        raise ValidationFailedError(detail, errors=[{"pointer": "/output/container", "detail": detail}])
    faces = look.options.faces
    if video.state == MediaState.READY and faces != "all" and max(faces) >= len(video.faces):
        detail = f"{video.id} has {len(video.faces)} face(s); their indices begin at 0"
        raise ValidationFailedError(detail, errors=[{"pointer": f"{look.place}/faces", "detail": detail}])


def _check_reference(reference: Media | None, look: Wanted) -> None:
    face = look.options.reference_face
    if reference is None or reference.state != MediaState.READY or face is None or face < len(reference.faces):
        return
    detail = f"{reference.id} has {len(reference.faces)} face(s); their indices begin at 0"
    raise ValidationFailedError(detail, errors=[{"pointer": f"{look.place}/reference_face", "detail": detail}])


def _check_apart(session: Session, look: Wanted) -> None:
    """Two videos that exchange their colours are not the same bytes, whatever their settings."""
    both = [media.get(session, media_id) for media_id in (look.video_id, look.reference_id)]
    if look.exchange is None and len({one.sha256 for one in both if one is not None}) == 1:
        detail = f"{look.reference_id} is the same clip; give `a` alone, with the two faces to exchange"
        raise ValidationFailedError(detail, errors=[{"pointer": "/b", "detail": detail}])


def remove(services: Services, role: Role, media_id: str, *, cancel_jobs: bool) -> None:
    """Delete a medium with everything derived from it: asset, results, and the file itself.

    Raises `NotFoundError`, and `ConflictError` while jobs need it and ``cancel_jobs`` is false.
    """
    database = services.database
    with database.write() as session:
        found = media.get(session, media_id, lock="update")
        if found is None or found.role != role:
            raise NotFoundError(f"there is no {role.value} {media_id}")
        active = media.active_jobs(session, media_id)
        if active and not cancel_jobs:
            detail = f"{len(active)} job(s) still use {media_id}: {', '.join(active[:10])}"
            raise ConflictError(f"{detail}; wait for them, or delete with ?cancel_jobs=true")
        for job_id in active:
            jobs.revoke(session, job_id, now=database.now())
        keys = media.delete(session, found)
    for key in keys:
        services.storage.delete(key)
