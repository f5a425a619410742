"""Ids on their way into addresses, and keys into headers: one id is one segment, and what is none goes nowhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from pvg_client import Client, Job, Medium, Webhook
from tests.client.lines import MEDIUM
from tests.client.test_retries import JOB, Script

#: every call that has an id in its address
CALLS: dict[str, Callable[[Client, Any], Any]] = {
    "medium": lambda client, some: client.medium(some),
    "delete": lambda client, some: client.delete(some),
    "job": lambda client, some: client.job(some),
    "wait": lambda client, some: client.wait(some),
    "cancel": lambda client, some: client.cancel(some),
    "events": lambda client, some: list(client.events(some)),
    "download": lambda client, some: client.download(some, Path("look.mp4")),
    "link": lambda client, some: client.link(some),
    "upload_state": lambda client, some: client.upload_state(some),
    "webhook": lambda client, some: client.webhook(some),
    "replay": lambda client, some: client.replay(some),
    "frame": lambda client, some: client.frame(some, 0),
    "poster": lambda client, some: client.poster(some),
    "thumbnail": lambda client, some: client.thumbnail(some, 0),
}
#: of those that have an address for an id that is none
ADDRESSED = {"upload_state"}


def ids() -> Iterator[str]:
    yield from ("", ".", "..", "job_1\n", "job_1?wait=1", "job_1#a", "job_1%2F..", "job_1;a", "job 1", "jöb_1", "\x00")
    for prefix in ("res_1", "ref_1", "vid_1"):
        yield from (f"{prefix}/../../videos/vid_2", f"{prefix}/", f"{prefix}\\..")


@pytest.mark.parametrize("call", CALLS)
def test_what_is_no_id_is_refused_before_anything_is_sent(call: str) -> None:
    for some in ids():
        if call in ADDRESSED and "/" in some:
            continue
        with Client(transport=Script()) as client, pytest.raises(ValueError, match="is no id"):
            CALLS[call](client, some)


def test_of_an_address_that_is_no_id_the_signature_is_not_told() -> None:
    with Client(transport=Script()) as client, pytest.raises(ValueError, match="is no id") as caught:
        client.download("http://service.test/v1/results/res_1?expires=1&signature=abc", "look.mp4")
    assert "results/res_1" in str(caught.value)
    assert "abc" not in str(caught.value)


#: every call that takes a key of the caller's own
KEYED: dict[str, Callable[..., Any]] = {
    "transfer": lambda client, **key: client.transfer("vid_1", reference="ref_1", **key),
    "swap": lambda client, **key: client.swap("vid_1", "vid_2", **key),
    "cancel": lambda client, **key: client.cancel("job_1", **key),
    "link": lambda client, **key: client.link("res_1", **key),
    "upload": lambda client, **key: client.upload(__file__, **key),
    "upload in pieces": lambda client, **key: client.upload(__file__, resume=True, **key),
    "upload by url": lambda client, **key: client.upload(url="https://elsewhere.test/clip.mp4", **key),
    "upload_link": lambda client, **key: client.upload_link(**key),
    "replay": lambda client, **key: client.replay("msg_1", **key),
    "rotate_webhook_secret": lambda client, **key: client.rotate_webhook_secret(**key),
}


@pytest.mark.parametrize("call", KEYED)
@pytest.mark.parametrize("key", ["a\nb", "a\r\nHost: b", "größe", "a b", " a", "a\x00", "\x7f"])
def test_a_key_that_no_header_can_carry_is_refused_before_anything_is_sent(
    call: str, key: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with Client(transport=Script()) as client, pytest.raises(ValueError, match="idempotency_key has spaces"):
        KEYED[call](client, idempotency_key=key)


@pytest.mark.parametrize("index", ["../../..", "0/../../poster", "0?layer=mask", ""])
def test_a_number_is_one_segment_too(index: Any) -> None:
    with Client(transport=Script()) as client:
        for call in (client.frame, client.thumbnail):
            with pytest.raises(ValueError, match="is no id"):
                call("vid_1", index)


def test_what_was_had_before_is_asked_for_again_as_it_is() -> None:
    at = {"created_at": MEDIUM["created_at"]}
    told = at | {"id": "msg_1", "job": "job_1", "url": "http://a.test", "state": "waiting", "attempts": 0}
    had = Medium.of(MEDIUM), Job.of(JOB | at), Webhook.of(told)
    script = Script(*[httpx.Response(200, json=one.raw) for one in had])
    with Client(transport=script) as client:
        assert (client.medium(had[0]), client.job(had[1]), client.webhook(had[2])) == had
    paths = ["/v1/videos/vid_1", f"/v1/jobs/{JOB['id']}", "/v1/webhooks/msg_1"]
    assert [request.url.path for request in script.requests] == paths


def test_ids_are_in_addresses_as_they_are() -> None:
    script = Script(*[httpx.Response(204) for _ in range(5)])
    ids = ["vid_0192f0c1a2b37c8d9e0f1a2b3c4d5e6f", "ref_A-z_9", "res_1", "job_1", "upl_1"]
    with Client("http://service.test/pvg", transport=script) as client:
        for some in ids:
            client.delete(some)
    kinds = ("videos", "references", "results", "jobs", "uploads")
    paths = [f"/pvg/v1/{kind}/{some}" for kind, some in zip(kinds, ids, strict=True)]
    assert [request.url.path for request in script.requests] == paths
