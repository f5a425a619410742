"""Signatures of links: who holds one may do what it was made for until it expires, without a key."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import os
import secrets
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from service.catalog import Clock
from service.errors import ForbiddenError, GoneError
from service.settings import Settings

_FILE = "link-secret"


class Signer:
    """HMAC-SHA256 (RFC 2104) over what a link is for, whose it is, the seal of its maker's key and its last second.

    A key's seal changes with its secret (`service.catalog.keys.seals`), and ends its links with it.

    The secret is that of the settings, or else a file of the data folder, made when it is first missed.
    """

    def __init__(self, settings: Settings, now: Clock) -> None:
        given = settings.link_secret.get_secret_value()
        self._secret = given.encode() if given else _secret_of(settings.folder / _FILE)
        self._now = now

    def sign(self, *what: str, by: str, seal: str, expires_at: datetime) -> dict[str, str]:
        """The query of a link to this, made by an owner; whole seconds count."""
        expires = str(int(expires_at.timestamp()))
        whose = {"by": by} if by else {}
        return {"expires": expires, **whose, "signature": self._signature(what, by, seal, expires)}

    def check(self, *what: str, by: str, seals: Sequence[str], expires: str, signature: str) -> datetime:
        """When a link to this expires, which has one of these seals of its key.

        Raises `ForbiddenError` for one that was not signed here, or with another secret of its key, `GoneError` for one
        that was and has expired.
        """
        expected = [self._signature(what, by, seal, expires).encode() for seal in seals]
        if not any(hmac.compare_digest(one, signature.encode()) for one in expected):
            raise ForbiddenError("this link was altered, or its key has another secret now; ask for another link")
        until = datetime.fromtimestamp(int(expires), UTC)
        if until < self._now():
            raise GoneError("this link has expired; ask for another one")
        return until

    def _signature(self, what: tuple[str, ...], by: str, seal: str, expires: str) -> str:
        said = json.dumps([*what, expires, *([by, seal] if by else [])]).encode()
        digest = hmac.digest(self._secret, said, hashlib.sha256)
        return base64.urlsafe_b64encode(digest).decode().rstrip("=")


def _secret_of(path: Path) -> bytes:
    """The secret in a file, which is made, complete or not at all, when there is none."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        draft = path.with_name(f"{path.name}.{secrets.token_hex(8)}")
        descriptor = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "w") as file:
            file.write(secrets.token_hex(32))
        with suppress(FileExistsError):  # another process was faster
            path.hardlink_to(draft)
        draft.unlink()
    return path.read_bytes().strip()
