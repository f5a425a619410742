"""`Idempotency-Key`: a POST that may be sent again, and is done once (draft-ietf-httpapi-idempotency-key-header-07)."""

from __future__ import annotations

import asyncio
import hashlib
import json
import math
import re
import secrets
from types import TracebackType
from typing import Annotated, Final, Self

import structlog
from fastapi import Depends, FastAPI, Header, Request
from pydantic import BaseModel
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session
from starlette.responses import JSONResponse

from service.addresses import unversioned
from service.api.authentication import CallerDep
from service.api.dependencies import ServicesDep
from service.api.services import Services
from service.catalog import idempotency
from service.catalog.idempotency import LOCK_S, Answer, Claim
from service.errors import BadRequestError, ConflictError, IdempotencyKeyInUseError, IdempotencyKeyReusedError

log = structlog.get_logger(__name__)

_BEAT_S: Final = 10.0
_KEY: Final = re.compile(r"[\x21-\x7e]{1,255}")


class Replay(Exception):  # noqa: N818 - no error: the request was done before
    """The request has been answered before: this is the answer.

    ``headers`` are those fields of it that are not kept, if a route adds them.
    """

    def __init__(self, answer: Answer) -> None:
        super().__init__()
        self.answer = answer
        self.headers: dict[str, str] = {}


class Once:
    """One POST. Inside the block it holds its Idempotency-Key, if it names one; an error inside it frees the key."""

    def __init__(self, services: Services, owner: str, key: str | None, call: str) -> None:
        self._services = services
        self._owner = owner
        self._key = key
        self._call = call
        self._digest = ""
        self._claim: Claim | None = None
        self._answered: Answer | None = None
        self._beats: asyncio.Task[None] | None = None
        #: it cancels something: on a full disk its key has a part of the reserve
        self.frees = False

    async def __aenter__(self) -> Self:
        if self._key is not None:
            claim = Claim(self._owner, self._key, secrets.token_hex(16))
            try:
                self._answered = await self._services.calls.write(self._begin, claim)
            except SQLAlchemyError:
                await self._free(claim)  # it may have been claimed, and the answer of the database lost
                raise
            if self._answered is None:
                self._claim = claim
                self._beats = asyncio.create_task(self._beat(claim))
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._beats is not None:
            self._beats.cancel()
        if self._claim is not None and error is not None:
            await self._free(self._claim)

    async def _free(self, claim: Claim) -> None:
        try:
            await self._services.calls.write(self._drop, claim)
        except Exception as failure:  # it is free when its lock is over; the first error is the one to tell of
            log.warning("an Idempotency-Key could not be freed", error=type(failure).__name__)

    @property
    def is_named(self) -> bool:
        """True when the request names a key."""
        return self._key is not None

    @property
    def answered(self) -> bool:
        """True when the request, or another with its key, was answered before."""
        return self._answered is not None

    def _begin(self, claim: Claim) -> Answer | None:
        database, ttl_s = self._services.database, self._services.settings.idempotency_ttl_s
        try:
            with database.write(frees=self.frees) as session:
                return idempotency.begin(session, claim, now=database.now(), lock_s=LOCK_S, ttl_s=ttl_s)
        except idempotency.InUseError as error:
            detail = "another request with this Idempotency-Key is being worked on; ask again for its answer"
            raise IdempotencyKeyInUseError(detail, retry_after_s=max(1, math.ceil(error.ask_in_s))) from error

    async def _beat(self, claim: Claim) -> None:
        """Hold the key while a long upload arrives."""
        while True:
            await asyncio.sleep(_BEAT_S)
            try:
                await self._services.calls.write(self._hold, claim)
            except Exception as error:  # a claim that is lost is noticed when the answer is kept
                log.warning("an Idempotency-Key could not be held", error=type(error).__name__)

    def _hold(self, claim: Claim) -> None:
        database = self._services.database
        with database.write() as session:
            idempotency.hold(session, claim, now=database.now(), lock_s=LOCK_S)

    def _drop(self, claim: Claim) -> None:
        with self._services.database.write() as session:
            idempotency.drop(session, claim)

    def compare(self, asked: object) -> None:
        """Say what the request asks for, as JSON has it. Call it before anything is recorded.

        Raises `Replay` when the same was asked for and answered before, `IdempotencyKeyReusedError` when another was.
        """
        if self._key is None:
            return
        self._digest = hashlib.sha256(json.dumps([self._call, asked], sort_keys=True).encode()).hexdigest()
        if self._answered is None:
            return
        if self._answered.digest != self._digest:
            raise IdempotencyKeyReusedError("this Idempotency-Key was used for another request; take a new one")
        raise Replay(self._answered)

    def keep(self, session: Session, status: int, body: BaseModel, *, location: str | None, resource_id: str) -> None:
        """Keep the answer, in the transaction that makes what it tells of; `ConflictError` undoes both."""
        if self._claim is None:
            return
        answer = Answer(self._digest, status, location, body.model_dump(mode="json"))
        if not idempotency.keep(session, self._claim, answer, resource_id=resource_id):
            raise ConflictError("this request took too long, and its Idempotency-Key was used again")


async def _once(
    request: Request,
    services: ServicesDep,
    caller: CallerDep,
    idempotency_key: Annotated[
        str | None,
        Header(
            description="up to 255 visible ASCII characters: the same request with the same key is done once in 24 h",
            json_schema_extra={"pattern": "^[!-~]{1,255}$"},
        ),
    ] = None,
) -> Once:
    key = idempotency_key
    if key is not None:
        key = key[1:-1] if len(key) > 2 and key[0] == key[-1] == '"' else key
        if not _KEY.fullmatch(key) or len(request.headers.getlist("idempotency-key")) > 1:
            raise BadRequestError("the Idempotency-Key must have 1 to 255 visible ASCII characters, without spaces")
    return Once(services, caller.owner, key, f"{request.method} {unversioned(request.url.path)}")


OnceDep = Annotated[Once, Depends(_once)]


def install(app: FastAPI) -> None:
    """Register the answer to a request that was answered before."""

    @app.exception_handler(Replay)
    async def on_replay(_: Request, replay: Replay) -> JSONResponse:
        answer = replay.answer
        # which of them hold a secret is not known here, and no answer to a POST is worth keeping
        headers = {**replay.headers, "Idempotent-Replayed": "true", "Cache-Control": "no-store"}
        if answer.location is not None:
            headers["Location"] = answer.location
        return JSONResponse(answer.body, status_code=answer.status, headers=headers)
