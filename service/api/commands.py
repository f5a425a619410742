"""The use cases: what a request makes of the records, the files and the queue."""

from __future__ import annotations

import secrets
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial

import structlog
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from service import addresses
from service.api import lookups, quotas
from service.api.idempotency import Once
from service.api.schemas import (
    CLIP_CONTAINERS,
    IMAGE_CONTAINERS,
    USUAL_CONTAINERS,
    Contrast,
    JobBody,
    LookOptions,
    MediaBody,
    OutputRequest,
)
from service.api.services import Services
from service.api.storing import store
from service.api.uploads import ReceivedFile
from service.api.views import media_body
from service.catalog import (
    DEFAULT_VECTOR_SETTINGS,
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
    keys,
    media,
    parts,
    resumable,
    tombstones,
    webhooks,
)
from service.errors import ConflictError, MediaFailedError, NotFoundError, ValidationFailedError
from service.ids import new_id

log = structlog.get_logger(__name__)

_TRIES = 3
#: options of an output that still pictures do not have
_OF_CLIPS = frozenset({"codec", "crf", "preset", "audio", "matte"})


@dataclass(frozen=True)
class Asked:
    """Whose request it is, how it is answered once, and what its sender calls it."""

    owner: str
    once: Once
    metadata: dict[str, str] = field(default_factory=dict)
    #: the receiver that is told of the job's end
    webhook: str | None = None
    #: make it again even if it was made before
    force: bool = False
    #: the resumable upload whose bytes it is, which ends with it
    upload: str | None = None


@dataclass(frozen=True)
class Registered:
    """A recorded file; ``pending`` when there is a vectorisation to wait for because of it, ``new`` when it is new."""

    body: MediaBody
    pending: bool
    location: str
    new: bool = False


async def register(
    services: Services,
    role: Role,
    file: ReceivedFile,
    vector: VectorSettings = DEFAULT_VECTOR_SETTINGS,
    *,
    asked: Asked,
    answers: bool = True,
) -> Registered:
    """Store a received file and record it.

    The same bytes of one owner in the same role, vectorised with the same settings, are the same medium; one that
    failed is vectorised again. ``answers`` when its medium is what the request is answered with.
    Raises `QuotaExceededError`, and `UnavailableError` when the store took too long.
    """
    arrival = _Arrival(services, role, file, vector, asked, answers)
    for _ in range(_TRIES):
        registered = await arrival.register()
        if registered is not None:
            return registered
    raise ConflictError("this file is being uploaded and deleted at the same time; try again")


@dataclass(frozen=True)
class _Arrival:
    """A received file on its way into the records: its bytes are stored between two transactions, and hold up none."""

    services: Services
    role: Role
    file: ReceivedFile
    vector: VectorSettings
    asked: Asked
    answers: bool

    async def register(self) -> Registered | None:
        """One try; None when another request was faster, to record or to delete the same."""
        calls = self.services.calls
        known, is_lost = await calls.read(self._look)
        if known is not None and not is_lost:
            return (await calls.write(self._heal, known, None))[0]
        # a file that is stored again has a key of its own: of two who do so, the one that fails takes nothing away
        media_id = known.id if known is not None else new_id("vid" if self.role is Role.VIDEO else "ref")
        name = media_id if known is None else f"{media_id}-{secrets.token_hex(4)}"
        key = self.services.storage.key("source", self.file.sha256, name, self.file.kind.suffix)
        return await store(self.services, self.file.path, key, partial(self._record, known, media_id, key))

    def _record(self, known: Media | None, media_id: str, key: str) -> tuple[Registered | None, bool]:
        """The answer, and whether a record names the file of ``key``."""
        if known is not None:
            return self._heal(known, key)
        created = self._create(media_id, key)
        return created, created is not None

    def _look(self) -> tuple[Media | None, bool]:
        """The medium that this is, if it is known, and whether its file is lost."""
        with self.services.database.read() as session:
            known = self._find(session)
        return known, known is not None and not self.services.storage.exists(known.source_key)

    def _find(self, session: Session, *, lock: bool = False) -> Media | None:
        return media.find_content(session, self.role, self.file.sha256, self.vector, owner=self.asked.owner, lock=lock)

    def _create(self, media_id: str, key: str) -> Registered | None:
        services, file, owner = self.services, self.file, self.asked.owner
        upload = Upload(
            media_id=media_id,
            role=self.role,
            sha256=file.sha256,
            size_bytes=file.size_bytes,
            content_type=file.kind.content_type,
            filename=file.filename,
            source_key=key,
            settings=self.vector,
            owner=owner,
            metadata=self.asked.metadata if self.answers else {},
        )
        now = services.database.now()
        try:
            with services.database.write() as session:
                self._close_upload(session, media_id, now=now)
                quotas.check(session, owner, now=now, size_bytes=file.size_bytes)
                created = media.create(session, upload, now=now, ttl_s=services.settings.media_ttl_s)
                registered = self._registered(session, created, pending=True, new=True)
        except IntegrityError:
            return None
        services.publisher.publish([Message(created.job_id, JobKind.VECTORIZE.value)])
        return registered

    def _heal(self, known: Media, key: str | None) -> tuple[Registered | None, bool]:
        """Answer with a medium that is known, and whether its file is that of ``key`` from now on, if it was lost."""
        services, asked, now = self.services, self.asked, self.services.database.now()
        with services.database.write() as session:
            keys.lock(session, asked.owner)
            renamed = bool(asked.metadata) and self.answers
            if renamed:  # before its medium, as its worker does
                jobs.get(session, known.job_id, lock=True)
            found = self._find(session, lock=True)
            if found is None or found.id != known.id or (renamed and found.job_id != known.job_id):
                return None, False
            self._close_upload(session, found.id, now=now)
            if found.state == MediaState.FAILED:
                quotas.check(session, asked.owner, now=now)
            is_used = key is not None and found.source_key == known.source_key
            if key is not None and is_used:
                media.replace_source(session, found, key, now=now)
            if renamed:
                media.name(session, found, asked.metadata)
            again = media.vectorize_again(session, found, now=now)
            media.keep(session, [found.id], now=now, ttl_s=services.settings.media_ttl_s)
            session.flush()
            session.refresh(found)
            registered = self._registered(session, found, pending=again)
        if again:
            services.publisher.publish([Message(found.job_id, JobKind.VECTORIZE.value)])
        return registered, is_used

    def _close_upload(self, session: Session, media_id: str, *, now: datetime) -> None:
        """End the upload that the file came by, so that its bytes are not counted twice."""
        asked = self.asked
        if asked.upload is None:
            return
        keys.lock(session, asked.owner)  # before anything else, as everywhere
        upload = resumable.get(session, asked.upload, owner=asked.owner, now=now, lock=True)
        if upload is None:
            raise NotFoundError(f"there is no upload {asked.upload} any more")
        if upload.media_id is not None:
            raise ConflictError(f"{asked.upload} is complete: {upload.media_id}")
        file = self.file
        resumable.close(session, upload, media_id=media_id, size_bytes=file.size_bytes, filename=file.filename, now=now)

    def _registered(self, session: Session, found: Media, *, pending: bool, new: bool = False) -> Registered:
        location = addresses.of_media(self.services.settings, found.role, found.id)
        body, asked = media_body(found, self.services.settings), self.asked
        if self.answers:
            if asked.webhook is not None and (job := jobs.get(session, found.job_id)) is not None:
                webhooks.announce(session, job, asked.webhook, now=self.services.database.now())
            asked.once.keep(session, 202 if pending else 200, body, location=location, resource_id=found.id)
        return Registered(body, pending, location, new)


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


def check_looks(
    services: Services,
    owner: str,
    looks: Sequence[Wanted],
    output: OutputRequest,
    pointers: dict[str, str],
    *,
    output_at: str = "/output",
) -> None:
    """Raise what `request_looks` would raise for a transfer, and record nothing."""
    with services.database.read() as session:
        _check(media.several(session, owner, pointers), looks, output, pointers, output_at)
        quotas.check(session, owner, now=services.database.now(), lock=False)


def request_looks(
    services: Services,
    kind: JobKind,
    looks: Sequence[Wanted],
    output: OutputRequest,
    pointers: dict[str, str],
    asked: Asked,
    *,
    output_at: str = "/output",
) -> tuple[JobBody, bool]:
    """Record a job that makes these looks and publish it once its media are ready. Returns it, and True when it is new.

    The owner's job of the same looks is returned instead while it goes on, or while its results are kept, unless
    ``asked.force``. ``pointers`` says where in the request each id stands, ``output_at`` where the options of the
    output do, for errors. Raises `NotFoundError` for an unknown id, `MediaFailedError` for a medium that failed,
    `ValidationFailedError` for what does not fit the video, `QuotaExceededError`, and `StorageFullError` when there is
    too little room to do the job.
    """
    services.room.require()
    database, owner = services.database, asked.owner
    request = RenderRequest(_output_options(output))
    outputs = [NewLook(look.video_id, look.reference_id, params_of(look)) for look in looks]
    with database.write() as session:
        now = database.now()
        # until the end of the transaction: no other request of this key is counted, nor asks for the same of this video
        keys.lock(session, owner)
        known = media.several(session, owner, pointers, lock=True)
        _check(known, looks, output, pointers, output_at)
        if kind is JobKind.SWAP:
            _check_apart(known, looks[0])
        mark = jobs.fingerprint(kind, request, outputs, asked.metadata)
        job = None if asked.force else jobs.find_same(session, owner, mark, now=now)
        new = job is None
        if job is None:
            quotas.check(session, owner, now=now)
            # they stay as they are until the job is recorded: one that is ready later lets it go then
            ready = all(one.state == MediaState.READY for one in known.values())
            job = jobs.create(
                session,
                kind,
                request=request,
                now=now,
                outputs=outputs,
                owner=owner,
                metadata=asked.metadata,
                ready=ready,
            )
        if asked.webhook is not None:
            webhooks.announce(session, job, asked.webhook, now=now)
        media.keep(session, list(pointers), now=now, ttl_s=services.settings.media_ttl_s)
        body = lookups.of_job(services.settings, services.room, session, job, forecasts=services.forecasts)
        location = addresses.of_job(services.settings, job.id)
        asked.once.keep(session, 202 if new else 200, body, location=location, resource_id=job.id)
    if new and not job.waiting:
        services.publisher.publish([jobs.message_of(job)])
    return body, new


def params_of(look: Wanted) -> LookParams:
    """How a look is asked for, as it is recorded."""
    options = look.options
    return LookParams(
        strength=options.strength,
        contrast=look.exchange or options.contrast,
        match=options.match,
        protect=tuple(options.protect),
        faces=options.faces if options.faces == "all" else tuple(options.faces),
        makeup=options.makeup if isinstance(options.makeup, float) else options.makeup.model_dump(),
        light=options.light,
        scene=options.scene,
        extent=options.extent,
        reference_face=options.reference_face,
        beta=options.beta,
        iterations=options.iterations,
        seed=options.seed,
        exchange=look.exchange is not None,
    )


def _output_options(output: OutputRequest) -> OutputOptions:
    return OutputOptions(
        # a container that is not of the video's kind is refused, so this says the same as none
        container=None if output.container in USUAL_CONTAINERS else output.container,
        codec=output.codec,
        crf=output.crf,
        preset=output.preset,
        audio=output.audio,
        extras=tuple(output.extras),
        matte=output.matte,
    )


def _check(
    known: Mapping[str, Media],
    looks: Sequence[Wanted],
    output: OutputRequest,
    pointers: Mapping[str, str],
    output_at: str,
) -> None:
    _check_usable(known, pointers)
    _check_output({known[look.video_id] for look in looks}, output, output_at)
    for look in looks:
        _check_container(known[look.video_id], output, output_at)
        check_look(known[look.video_id], known.get(look.reference_id), look, pointers[look.video_id])


def _check_usable(known: Mapping[str, Media], pointers: Mapping[str, str]) -> None:
    """Name all media that are not there or, when all are, all that have failed."""
    missing = {
        where: f"there is no {'video' if media_id.startswith('vid') else 'reference'} {media_id}"
        for media_id, where in pointers.items()
        if media_id not in known
    }
    if missing:
        errors = [{"pointer": where, "detail": detail} for where, detail in missing.items()]
        raise NotFoundError(errors[0]["detail"], errors=errors)
    failed = {
        where: error
        for media_id, where in pointers.items()
        if known[media_id].state == MediaState.FAILED and (error := known[media_id].error) is not None
    }
    if failed:
        (where, error), *_ = failed.items()
        raise MediaFailedError(error, where, failed)


def check_look(video: Media, reference: Media | None, look: Wanted, where: str) -> None:
    """Raise `ValidationFailedError` when a look does not fit its media, as far as they are known yet.

    ``where`` the video stands in the request, as a JSON pointer.
    """
    if video.role != Role.VIDEO:
        detail = f"{video.id} is a reference; upload the file to /videos to change its colours"
        raise ValidationFailedError(detail, errors=[{"pointer": where, "detail": detail}])
    faces = look.options.faces
    if video.state == MediaState.READY and faces != "all" and max(faces) >= len(video.faces):
        detail = f"{video.id} has {len(video.faces)} face(s); their indices begin at 0"
        raise ValidationFailedError(detail, errors=[{"pointer": f"{look.place}/faces", "detail": detail}])
    _check_reference(reference, look)


def _check_container(video: Media, output: OutputRequest, output_at: str) -> None:
    is_image = video.content_type.startswith("image/")
    allowed = IMAGE_CONTAINERS if is_image else CLIP_CONTAINERS
    if output.container is not None and output.container not in allowed:
        detail = f"{video.id} is {'an image' if is_image else 'a clip'}: the container must be one of "
        detail += ", ".join(allowed)
        raise ValidationFailedError(detail, errors=[{"pointer": f"{output_at}/container", "detail": detail}])


def _check_output(videos: Set[Media], output: OutputRequest, output_at: str) -> None:
    """Still pictures have no codec and no sound: what is asked for in vain is refused, not passed over."""
    if any(not video.content_type.startswith("image/") for video in videos):
        return
    names = sorted(name for name in _OF_CLIPS & output.model_fields_set if getattr(output, name) is not None)
    if names:
        which = ", ".join(sorted(video.id for video in videos))
        detail = f"of clips only, and {which} is an image"
        errors = [{"pointer": f"{output_at}/{name}", "detail": detail} for name in names]
        raise ValidationFailedError(f"{output_at}/{names[0]}: {detail}", errors=errors)


def _check_reference(reference: Media | None, look: Wanted) -> None:
    face = look.options.reference_face
    if reference is None or reference.state != MediaState.READY or face is None or face < len(reference.faces):
        return
    detail = f"{reference.id} has {len(reference.faces)} face(s); their indices begin at 0"
    raise ValidationFailedError(detail, errors=[{"pointer": f"{look.place}/reference_face", "detail": detail}])


def _check_apart(known: Mapping[str, Media], look: Wanted) -> None:
    """Two videos that exchange their colours are not the same bytes, whatever their settings."""
    if look.exchange is None and known[look.video_id].sha256 == known[look.reference_id].sha256:
        detail = f"{look.reference_id} is the same clip; give `a` alone, with the two faces to exchange"
        raise ValidationFailedError(detail, errors=[{"pointer": "/b", "detail": detail}])


async def remove(services: Services, owner: str, role: Role, media_id: str, *, cancel_jobs: bool) -> None:
    """Delete a medium with everything derived from it: asset, results, and the file itself.

    Raises `NotFoundError`, and `ConflictError` while jobs need it and ``cancel_jobs`` is false.
    """
    keys = await services.calls.write(_remove, services, owner, role, media_id, cancel_jobs=cancel_jobs)
    await services.calls.store(services.blobs.delete, keys)


def _remove(services: Services, owner: str, role: Role, media_id: str, *, cancel_jobs: bool) -> list[str]:
    """Remove the records. Returns the blobs that are to go."""
    database = services.database
    with database.write() as session:
        found = media.get(session, media_id, owner=owner, lock="update")
        if found is None or found.role != role:
            raise NotFoundError(f"there is no {role.value} {media_id}")
        active = media.active_jobs(session, media_id)
        if active and not cancel_jobs:
            detail = f"{len(active)} job(s) still use {media_id}: {', '.join(active[:10])}"
            raise ConflictError(f"{detail}; wait for them, or delete with ?cancel_jobs=true")
        keys, ended = _delete(session, found, active, now=database.now())
    services.publisher.withdraw(ended)
    return keys


def _delete(session: Session, found: Media, active: Sequence[str], *, now: datetime) -> tuple[list[str], list[Message]]:
    """Remove a medium whose unfinished jobs are ``active``. Returns the blobs and the messages that are to go."""
    ended, drawn = parts.messages(session, active), parts.files_of(session, active)
    drawn += tombstones.written_for(session, active)
    for job_id in active:
        jobs.revoke(session, job_id, now=now)
    ended += [jobs.message_of(job) for job_id in active if (job := jobs.get(session, job_id))]
    return media.delete(session, found, now=now) + drawn, ended


async def take_back(services: Services, owner: str, brought: Sequence[MediaBody]) -> None:
    """Delete the media that a refused request has brought, but for those that others have asked for since.

    Never fails: they go after their retention.
    """
    if not brought:
        return
    try:
        keys = await services.calls.write(_take_back, services, owner, brought)
        await services.calls.store(services.blobs.delete, keys)
    except Exception as error:
        log.warning("what a refused request has brought stays", count=len(brought), error=type(error).__name__)


def _take_back(services: Services, owner: str, brought: Sequence[MediaBody]) -> list[str]:
    keys: list[str] = []
    messages: list[Message] = []
    with services.database.write() as session:
        for body in sorted(brought, key=lambda body: body.id):
            found = media.get(session, body.id, owner=owner, lock="update")
            # whoever asks for it, or uses it, counts its retention anew
            if found is None or found.expires_at != body.expires_at:
                continue
            blobs, ended = _delete(session, found, media.active_jobs(session, found.id), now=services.database.now())
            keys += blobs
            messages += ended
    services.publisher.withdraw(messages)
    return keys
