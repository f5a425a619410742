"""A received file becomes a medium, or is found to be one that is known."""

from __future__ import annotations

import secrets
from dataclasses import dataclass
from datetime import datetime
from functools import partial

from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from service import addresses
from service.api import quotas
from service.api.commands.asked import Asked
from service.api.schemas import MediaBody
from service.api.services import Services
from service.api.storing import store
from service.api.uploads import ReceivedFile
from service.api.views import media_body
from service.catalog import (
    DEFAULT_VECTOR_SETTINGS,
    JobKind,
    JobState,
    Media,
    MediaState,
    Message,
    Role,
    Upload,
    VectorSettings,
    jobs,
    media,
    resumable,
    webhooks,
)
from service.errors import ConflictError, NotFoundError
from service.ids import new_id

_TRIES = 3


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
                quotas.check(session, owner, now=now, size_bytes=file.size_bytes, lately=services.lately)
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
            quotas.lock_key(session, asked.owner)
            job = jobs.get(session, known.job_id, lock=True)  # before its medium, as its worker does
            found = self._find(session, lock=True)
            if found is None or (found.id, found.job_id) != (known.id, known.job_id):
                return None, False
            if job is not None and job.state == JobState.CANCELING:  # its end would be that of what is asked for now
                jobs.revoke(session, job.id, now=now)
                session.refresh(found)
            self._close_upload(session, found.id, now=now)
            if found.state == MediaState.FAILED:
                quotas.check(session, asked.owner, now=now)
            is_used = key is not None and found.source_key == known.source_key
            if key is not None and is_used:
                media.replace_source(session, found, key, now=now)
            if asked.metadata and self.answers and not asked.by_link:
                media.name(session, found, asked.metadata)
            if self.file.filename is not None and not asked.by_link:
                found.filename = self.file.filename
            again = media.vectorize_again(session, found, now=now)
            media.keep([found], now=now, ttl_s=services.settings.media_ttl_s)
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
        quotas.lock_key(session, asked.owner)  # before anything else, as everywhere
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
