from __future__ import annotations

import base64
import hashlib
import hmac
import time

import pytest
from standardwebhooks import Webhook, WebhookVerificationError

from service.webhooks import signed_headers

SECRETS = ["whsec_" + base64.b64encode(bytes([one]) * 32).decode() for one in (1, 2)]
BODY = '{"type":"job.succeeded","data":{"file":"Größe.mp4"}}'.encode()


def test_a_signature_is_that_of_the_specification() -> None:
    headers = signed_headers("msg_1", 1_767_225_600, BODY, SECRETS[:1])
    wanted = base64.b64encode(hmac.new(bytes([1]) * 32, b"msg_1.1767225600." + BODY, hashlib.sha256).digest())
    assert headers == {
        "webhook-id": "msg_1",
        "webhook-timestamp": "1767225600",
        "webhook-signature": f"v1,{wanted.decode()}",
    }


def test_receivers_verify_with_either_of_two_secrets_and_no_other() -> None:
    headers = signed_headers("msg_1", int(time.time()), BODY, SECRETS)
    for secret in SECRETS:
        assert Webhook(secret).verify(BODY, headers)["type"] == "job.succeeded"
    with pytest.raises(WebhookVerificationError):
        Webhook("whsec_" + base64.b64encode(b"3" * 32).decode()).verify(BODY, headers)
    for tampered in (headers | {"webhook-id": "msg_2"}, headers | {"webhook-timestamp": str(int(time.time()) - 9)}):
        with pytest.raises(WebhookVerificationError):
            Webhook(SECRETS[0]).verify(BODY, tampered)
    with pytest.raises(WebhookVerificationError):
        Webhook(SECRETS[0]).verify(BODY + b" ", headers)
