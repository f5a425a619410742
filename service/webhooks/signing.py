"""Signatures of webhooks (Standard Webhooks 1.0.0, symmetric scheme ``v1``)."""

from __future__ import annotations

import base64
import hashlib
import hmac
from collections.abc import Sequence

from service.catalog.webhooks import SECRET_PREFIX


def signed_headers(message_id: str, timestamp: int, body: bytes, secrets: Sequence[str]) -> dict[str, str]:
    """The header fields of a message, with a signature by each of the secrets (``whsec_`` and base64).

    ``timestamp`` is that of the attempt, in seconds from 1970: receivers refuse one that is minutes off, so that nobody
    can send them a message of old.
    """
    signed = f"{message_id}.{timestamp}.".encode() + body
    signatures = [
        base64.b64encode(hmac.digest(base64.b64decode(secret.removeprefix(SECRET_PREFIX)), signed, hashlib.sha256))
        for secret in secrets
    ]
    return {
        "webhook-id": message_id,
        "webhook-timestamp": str(timestamp),
        "webhook-signature": " ".join(f"v1,{one.decode()}" for one in signatures),
    }
