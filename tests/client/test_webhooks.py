"""Whose webhooks are believed. The signatures are those of the package `standardwebhooks` 1.1.0 for the same texts."""

from __future__ import annotations

import base64

import pytest

from pvg_client import WebhookError, verify_webhook

SECRET = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"
OTHER = "whsec_C2FVsBQIhrscChlQIMV+b5sSYspob7oD"
NOW = 1614265330
BODY = b'{"test": 2432232314}'
SIGNATURE = "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="
VECTORS = [
    (SECRET, '{"test": 2432232314}', SIGNATURE),
    (SECRET, '{"état": "succeeded"}', "v1,WEiCcbiPqkQ4RNOUh0yXdwLrmeSyYMp5mM7k35zubIk="),
    (OTHER, '{"test": 2432232314}', "v1,78nXHjpFP0tVJQW5D0SBwmVyyW87BV/rL6MgfM/Bw44="),
    (OTHER, '{"état": "succeeded"}', "v1,eJ+U5ZY4tYfw8oW0FIKn0t1Wpte9tlL/N7p4s/MKeqU="),
]


def headers(signature: str = SIGNATURE, **changed: str) -> dict[str, str]:
    sent = {"id": "msg_p5jXN8AQM9LWM0D4loKWxJek", "timestamp": str(NOW), "signature": signature} | changed
    return {f"Webhook-{name.title()}": value for name, value in sent.items()}


@pytest.mark.parametrize(("secret", "body", "signature"), VECTORS)
def test_what_others_have_signed_is_believed(secret: str, body: str, signature: str) -> None:
    for given in (secret, secret.removeprefix("whsec_")):
        assert verify_webhook(body, headers(signature), given, now=NOW)
        assert verify_webhook(body.encode(), headers(signature), given, now=NOW)


def test_the_names_of_headers_have_no_case_and_others_are_passed_over() -> None:
    lower = {name.lower(): value for name, value in headers().items()}
    assert verify_webhook(BODY, lower | {"host": "x"}, SECRET, now=NOW) == {"test": 2432232314}


def test_one_good_signature_of_several_is_enough() -> None:
    wrong = "v1," + base64.b64encode(bytes(32)).decode()
    for several in (f"{wrong} {SIGNATURE}", f"v1a,AAAA {SIGNATURE} {wrong}", f"é {SIGNATURE}"):
        assert verify_webhook(BODY, headers(several), SECRET, now=NOW)
    for several in (wrong, f"{wrong} {wrong}", "", "v1,", "v1", SIGNATURE.replace("v1,", "v2,"), SIGNATURE[:-1]):
        with pytest.raises(WebhookError, match="no signature"):
            verify_webhook(BODY, headers(several), SECRET, now=NOW)


def test_what_was_changed_on_the_way_is_not_believed() -> None:
    changed = [(BODY + b" ", headers(), SECRET), (BODY, headers(id="msg_2"), SECRET), (BODY, headers(), OTHER)]
    changed.append((BODY, headers(timestamp=str(NOW + 1)), SECRET))
    for body, sent, secret in changed:
        with pytest.raises(WebhookError, match="no signature"):
            verify_webhook(body, sent, secret, now=NOW)


def test_what_is_no_text_has_no_good_signature() -> None:
    for wrong in ("\udc80", "\ud800"):
        for sent in (headers(SIGNATURE[:-1] + wrong), headers(id="msg_" + wrong)):
            with pytest.raises(WebhookError, match="no signature"):
                verify_webhook(BODY, sent, SECRET, now=NOW)
        with pytest.raises(WebhookError, match="no signature"):
            verify_webhook(f'"{wrong}"', headers(), SECRET, now=NOW)
        with pytest.raises(WebhookError, match="no number"):
            verify_webhook(BODY, headers(timestamp=str(NOW) + wrong), SECRET, now=NOW)
        assert verify_webhook(BODY, headers(f"{wrong} {SIGNATURE}"), SECRET, now=NOW)


def test_five_minutes_are_believed_either_way() -> None:
    for off in (-300, 300):
        assert verify_webhook(BODY, headers(), SECRET, now=NOW + off)
    with pytest.raises(WebhookError, match="301 s old"):
        verify_webhook(BODY, headers(), SECRET, now=NOW + 301)
    with pytest.raises(WebhookError, match="future"):
        verify_webhook(BODY, headers(), SECRET, now=NOW - 301)
    with pytest.raises(WebhookError, match="s old"):
        verify_webhook(BODY, headers(), SECRET)


def test_a_header_that_is_missing_or_no_number_is_said() -> None:
    for name in ("Webhook-Id", "Webhook-Timestamp", "Webhook-Signature"):
        sent = headers()
        del sent[name]
        with pytest.raises(WebhookError, match=name.lower()):
            verify_webhook(BODY, sent, SECRET, now=NOW)
    for stamp in ("", "soon", "1.5", "9" * 400, "-" + "9" * 400, "9" * 9000):
        with pytest.raises(WebhookError, match="no number"):
            verify_webhook(BODY, headers(timestamp=stamp), SECRET, now=NOW)


def test_a_secret_that_is_none_is_the_callers_error() -> None:
    for secret in ("", "whsec_", "whsec_ä", "not base64!"):
        with pytest.raises(ValueError, match="secret"):
            verify_webhook(BODY, headers(), secret, now=NOW)
