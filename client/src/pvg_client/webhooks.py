"""Whether a webhook is the service's own: Standard Webhooks (standardwebhooks.com, specification 1.0)."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import time
from collections.abc import Mapping
from typing import Any, Final

from pvg_client.errors import WebhookError

#: seconds that a webhook's time may be off, either way
TOLERANCE_S: Final = 300
_PREFIX: Final = "whsec_"


def verify_webhook(
    payload: bytes | str, headers: Mapping[str, str], secret: str, *, now: float | None = None
) -> dict[str, Any]:
    """What a webhook says, once it is sure that the holder of the secret sent it within the last five minutes.

    ``payload`` is the body as it arrived, not as it was read and written again. ``secret`` is base64, with or without
    `whsec_`. ``now`` is in seconds since 1970. A webhook that comes again has the same `webhook-id`.

    Raises `WebhookError` when a header is missing, when it is too old or from the future, and when none of its
    signatures is good; `ValueError` when the secret is none.
    """
    sent = {name.lower(): value for name, value in headers.items()}
    try:
        message_id, timestamp, signatures = (sent[f"webhook-{part}"] for part in ("id", "timestamp", "signature"))
        age_s = float(time.time() if now is None else now) - int(timestamp)
    except KeyError as error:
        raise WebhookError(f"the webhook has no header {error.args[0]}") from error
    except (ValueError, OverflowError) as error:
        raise WebhookError("the webhook's timestamp is no number") from error
    if abs(age_s) > TOLERANCE_S:
        raise WebhookError(f"the webhook is {age_s:.0f} s old" if age_s > 0 else "the webhook is from the future")
    body = _bytes(payload) if isinstance(payload, str) else payload
    signed = _bytes(f"{message_id}.{timestamp}.") + body
    expected = b"v1," + base64.b64encode(hmac.digest(_key(secret), signed, hashlib.sha256))
    # every one is compared, in constant time: while a secret is replaced there are several
    good = [hmac.compare_digest(expected, _bytes(one)) for one in signatures.split()]
    if not any(good):
        raise WebhookError("no signature of the webhook is good")
    said: dict[str, Any] = json.loads(body)
    return said


def _bytes(text: str) -> bytes:
    # servers pass on what is no UTF-8 as surrogates: nothing that is signed has any, and all are compared
    return text.encode(errors="surrogatepass")


def _key(secret: str) -> bytes:
    text = secret.removeprefix(_PREFIX).rstrip("=")
    try:
        key = base64.b64decode(text + "=" * (-len(text) % 4), validate=True)
    except ValueError as error:
        raise ValueError("the secret of a webhook is base64, with or without whsec_") from error
    if not key:
        raise ValueError("the secret of a webhook is empty")
    return key
