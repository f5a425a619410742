from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.catalog import leases
from service.catalog.webhooks import FORMER_SECRET_S, FORMER_SECRETS
from service.settings import Settings
from tests.service.api.test_authentication import holder
from tests.service.api.test_media import PROBLEM, upload
from tests.service.api.test_resumable_uploads import begin, send
from tests.service.api.test_resumable_uploads import said as said_of
from tests.service.fixtures import MP4, PNG, Api, claim, make_ready, make_results, serve
from tests.service.receivers import Receiver
from tests.service.remote import answer as file_answer
from tests.service.remote import remote
from tests.waiting import until

URL = "https://studio.example/hooks?token=t"


@pytest.fixture
def api(tmp_path: Path) -> Iterator[Api]:
    # the last moments of a test are not waited for
    yield from serve(Settings(data_dir=tmp_path / "data", reap_interval_s=3600, allow_private_networks=True))


def ready(api: Api) -> tuple[str, str]:
    video, reference = upload(api, "/videos", uuid.uuid4().bytes), upload(api, "/references", uuid.uuid4().bytes)
    for medium in (video, reference):
        make_ready(api.services, medium["id"])
    return video["id"], reference["id"]


def transfer(api: Api, media: tuple[str, str], url: str, **more: Any) -> dict[str, Any]:
    body = {"video": media[0], "looks": [{"reference": media[1]}], "webhook": {"url": url}, **more}
    answer = api.client.post("/transfer", json=body)
    assert answer.status_code in {200, 202}, answer.text
    job: dict[str, Any] = answer.json()
    return job


def listed(api: Api, query: str = "") -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = api.client.get(f"/webhooks{query}").raise_for_status().json()["data"]
    return found


def test_a_receiver_is_told_of_the_end_of_a_transfer(api: Api) -> None:
    with Receiver().listening() as receiver:
        job = transfer(api, ready(api), receiver.url, metadata={"order": "42"})
        (waits,) = listed(api)
        assert (waits["state"], waits["job"], waits["url"], waits["type"], waits["attempts"]) == (
            "waiting",
            job["id"],
            receiver.url,
            None,
            0,
        )
        (result,) = make_results(api.services, job["id"], [b"result"])
        receiver.wait_for(1)
        until(lambda: bool(listed(api, "?state=delivered")))
    secret = api.client.get("/webhooks/secret").json()["secret"]
    said = receiver.got[0].verified(secret)
    assert said["type"] == "job.succeeded"
    assert said["data"]["metadata"] == {"order": "42"}
    assert said["data"]["looks"][0]["result"] == result
    shown = api.client.get(f"/webhooks/{waits['id']}").json()
    assert shown == listed(api)[0]
    assert (shown["id"], shown["type"], shown["attempts"], shown["last_status"]) == (
        receiver.got[0].id,
        "job.succeeded",
        1,
        204,
    )
    # told again because its owner wants it: the same id, and the receiver can tell
    again = api.client.post(f"/webhooks/{waits['id']}/replay", headers={"Idempotency-Key": "again"})
    assert again.status_code == 202


def test_a_replay_is_one_more_message_with_the_same_id(api: Api) -> None:
    with Receiver(answers=(410, 204)).listening() as receiver:
        job = transfer(api, ready(api), receiver.url)
        (delivery,) = listed(api)
        assert api.client.post(f"/webhooks/{delivery['id']}/replay").status_code == 409
        api.client.post(f"/jobs/{job['id']}/cancel").raise_for_status()
        until(lambda: bool(listed(api, "?state=failed")))
        headers = {"Idempotency-Key": "replay"}
        first = api.client.post(f"/webhooks/{delivery['id']}/replay", headers=headers)
        until(lambda: bool(listed(api, "?state=delivered")))
        second = api.client.post(f"/webhooks/{delivery['id']}/replay", headers=headers)
        assert (first.status_code, second.status_code) == (202, 202)
        assert second.headers["idempotent-replayed"] == "true"
        assert first.json()["state"] == "pending"
    assert [one.id for one in receiver.got] == [delivery["id"]] * 2
    assert receiver.got[1].verified(api.client.get("/webhooks/secret").json()["secret"])["type"] == "job.canceled"


def test_the_same_transfer_with_another_receiver_tells_both_and_each_once(api: Api) -> None:
    media = ready(api)
    with Receiver().listening() as one, Receiver().listening() as other:
        job = transfer(api, media, one.url)
        assert transfer(api, media, one.url)["id"] == job["id"]
        make_results(api.services, job["id"], [b"result"])
        assert transfer(api, media, other.url)["id"] == job["id"]
        until(lambda: len(listed(api, "?state=delivered")) == 2)
        assert len(listed(api, f"?job={job['id']}")) == 2
    assert (len(one.got), len(other.got)) == (1, 1)


def test_a_receiver_that_is_named_when_the_job_has_ended_is_told_again_but_not_by_a_replay(api: Api) -> None:
    media = ready(api)
    with Receiver().listening() as receiver:
        job = transfer(api, media, receiver.url)
        make_results(api.services, job["id"], [b"result"])
        body = {"video": media[0], "looks": [{"reference": media[1]}], "webhook": {"url": receiver.url}}
        for replayed in (None, "true"):
            again = api.client.post("/transfer", json=body, headers={"Idempotency-Key": "again"})
            assert (again.status_code, again.headers.get("idempotent-replayed")) == (200, replayed)
            assert again.json()["id"] == job["id"]
        until(lambda: len(listed(api, "?state=delivered")) == 2)
        assert len(listed(api)) == 2
    assert {one.id for one in receiver.got} == {one["id"] for one in listed(api)}
    secret = api.client.get("/webhooks/secret").json()["secret"]
    assert [one.verified(secret)["data"]["id"] for one in receiver.got] == [job["id"]] * 2


def test_a_swap_and_a_form_can_name_a_receiver(api: Api) -> None:
    media = ready(api)
    swap = {"a": media[0], "faces": [0, 1], "webhook": {"url": URL}}
    assert api.client.post("/swap", json=swap).status_code == 422  # it has one face
    another, _ = ready(api)
    job = api.client.post("/swap", json={"a": media[0], "b": another, "webhook": {"url": URL}}).json()
    form = {"video": media[0], "webhook": f"{URL}2"}
    formed = api.client.post("/transfer", data=form, files={"reference": ("a.png", PNG)}).json()
    assert {(one["job"], one["url"]) for one in listed(api)} == {(job["id"], URL), (formed["id"], f"{URL}2")}


def test_an_upload_by_form_can_name_a_receiver_of_its_vectorisation(api: Api) -> None:
    with Receiver().listening() as receiver:
        form = {"webhook": receiver.url, "metadata": "order:77"}
        medium = api.client.post("/videos", files={"file": ("a.mp4", MP4)}, data=form).json()
        lease = claim(api.services.database, medium["job"])
        with api.services.background.write() as session:
            assert leases.fail(session, lease, PROBLEM, now=api.services.database.now(), timings={})
        receiver.wait_for(1)
    said = receiver.got[0].verified(api.client.get("/webhooks/secret").json()["secret"])
    assert (said["type"], said["data"]["kind"], said["data"]["media"]) == ("job.failed", "vectorize", medium["id"])
    assert said["data"]["error"]["code"] == "no-face"
    assert said["data"]["metadata"] == {"order": "77"}


def by_query(client: httpx.Client, url: str) -> str:
    sent = client.post("/videos", params={"webhook": url}, content=MP4)
    return str(sent.raise_for_status().json()["id"])


def in_pieces(client: httpx.Client, url: str) -> str:
    address = begin(client, len(MP4), webhook=url)
    return send(client, address, 0, MP4).raise_for_status().headers["pvg-media"]


def by_link(client: httpx.Client, url: str) -> str:
    link = client.post("/uploads/link", json={"webhook": {"url": url}}).raise_for_status().json()["url"]
    httpx.put(client.base_url.join(link), content=MP4, timeout=60).raise_for_status()
    return str(client.get(link.partition("?")[0]).json()["media"])


@pytest.mark.parametrize("way", [by_query, in_pieces, by_link])
def test_every_way_to_upload_can_name_a_receiver(api: Api, way: Callable[[httpx.Client, str], str]) -> None:
    with Receiver().listening() as receiver:
        medium = way(api.client, receiver.url)
        make_ready(api.services, medium)
        receiver.wait_for(1)
        # the same file sent again has nothing to wait for, and its receiver is told so
        assert way(api.client, receiver.url) == medium
        receiver.wait_for(2)
    secret = api.client.get("/webhooks/secret").json()["secret"]
    assert [(said["type"], said["data"]["media"]) for said in (one.verified(secret) for one in receiver.got)] == [
        ("job.succeeded", medium)
    ] * 2
    assert {one.id for one in receiver.got} == {one["id"] for one in listed(api)}


def test_a_receiver_of_an_upload_that_may_not_be_asked_is_refused_where_it_stands(api: Api) -> None:
    wrong = "https://studio.example:22/"
    tus = {"Tus-Resumable": "1.0.0", "Upload-Length": "9", "Upload-Metadata": said_of(webhook=wrong)}
    refused = {
        "/query/webhook": api.client.post("/references", params={"webhook": wrong}, content=PNG),
        "/webhook": api.client.post("/uploads", headers=tus),
        "/webhook/url": api.client.post("/uploads/link", json={"webhook": {"url": wrong}}),
    }
    for pointer, answer in refused.items():
        assert (answer.status_code, answer.json()["code"]) == (422, "url-not-allowed")
        assert answer.json()["errors"][0]["pointer"] == pointer
    none = api.client.post("/videos", params={"webhook": "studio.example"}, content=MP4)
    form = api.client.post(
        "/videos", params={"webhook": URL}, files={"file": ("a.mp4", MP4)}, data={"webhook": f"{URL}2"}
    )
    for answer in (none, form):
        assert (answer.status_code, answer.json()["errors"][0]["pointer"]) == (422, "/query/webhook")
    assert api.blobs == []


@pytest.mark.parametrize(
    "url",
    [
        "ftp://studio.example/",
        "https://studio.example/a b",
        "https://studio.example/\n",
        "https://studio.example/é",
        "https://studio.example/" + "a" * 2048,
        "https://name:secret@studio.example/",
        "https://studio.example:22/",
        "https:///path",
        "http://a]b/",
        "",
    ],
)
def test_a_receiver_that_may_not_be_asked_is_refused(api: Api, url: str) -> None:
    video, reference = ready(api)
    body = {"video": video, "looks": [{"reference": reference}], "webhook": {"url": url}}
    answer = api.client.post("/transfer", json=body)
    assert (answer.status_code, answer.json()["code"]) == (422, "url-not-allowed")
    assert answer.json()["errors"][0]["pointer"] == "/webhook/url"
    assert "pattern" not in answer.json()["detail"]
    answer = api.client.post("/videos", files={"file": ("a.mp4", MP4)}, data={"webhook": url})
    assert (answer.status_code, answer.json()["errors"][0]["pointer"]) == (422, "/webhook")
    form = {"video": video, "reference": reference, "webhook": url}
    answer = api.client.post("/transfer", files={"reference": ("a.png", PNG)}, data=form)
    assert (answer.status_code, answer.json()["errors"][0]["pointer"]) == (422, "/webhook")
    assert listed(api) == []


def test_a_receiver_in_a_private_network_is_refused_where_they_are_not_allowed(tmp_path: Path) -> None:
    for api in serve(Settings(data_dir=tmp_path / "guarded", reap_interval_s=3600)):
        video, reference = ready(api)
        for url in ("http://127.0.0.1:9000/", "http://[::1]:9000/", "http://169.254.169.254/", "http://0x7f000001/"):
            body = {"video": video, "looks": [{"reference": reference}], "webhook": {"url": url}}
            answer = api.client.post("/transfer", json=body)
            assert (answer.status_code, answer.json()["code"]) == (422, "url-not-allowed")
        assert listed(api) == []


def test_unknown_fields_of_a_webhook_are_refused(api: Api) -> None:
    video, reference = ready(api)
    body = {"video": video, "looks": [{"reference": reference}], "webhook": {"url": URL, "secret": "x"}}
    answer = api.client.post("/transfer", json=body)
    assert (answer.status_code, answer.json()["errors"][0]["pointer"]) == (422, "/webhook/secret")


def test_secrets_are_rotated_once_for_an_idempotency_key_and_not_to_be_kept_by_caches(api: Api) -> None:
    first = api.client.get("/webhooks/secret")
    assert first.headers["cache-control"] == "no-store"
    assert api.client.get("/webhooks/secret").json() == first.json()
    assert first.json()["former_valid_until"] is None
    headers = {"Idempotency-Key": "rotate"}
    second = api.client.post("/webhooks/secret/rotate", headers=headers)
    assert second.headers["cache-control"] == "no-store"
    assert second.json()["secret"] != first.json()["secret"]
    assert second.json()["former_valid_until"] is not None
    again = api.client.post("/webhooks/secret/rotate", headers=headers)
    assert (again.json(), again.headers["cache-control"]) == (second.json(), "no-store")
    assert api.client.get("/webhooks/secret").json() == second.json()
    with Receiver().listening() as receiver:
        job = transfer(api, ready(api), receiver.url)
        api.client.post(f"/jobs/{job['id']}/cancel").raise_for_status()
        receiver.wait_for(1)
    for one in (first, second):
        assert receiver.got[0].verified(one.json()["secret"])["type"] == "job.canceled"


def test_a_secret_that_was_replaced_twice_is_good_still_and_too_many_are_refused(api: Api) -> None:
    rotate = "/webhooks/secret/rotate"
    secrets = [api.client.get("/webhooks/secret").json()["secret"]]
    secrets += [api.client.post(rotate).json()["secret"] for _ in range(FORMER_SECRETS)]
    refused = api.client.post(rotate)
    assert (refused.status_code, refused.json()["type"].rpartition("#")[2]) == (409, "conflict")
    assert f"{FORMER_SECRETS} former secrets are signed with still" in refused.json()["detail"]
    assert FORMER_SECRET_S - 120 < int(refused.headers["retry-after"]) <= FORMER_SECRET_S
    assert api.client.get("/webhooks/secret").json()["secret"] == secrets[-1]
    with Receiver().listening() as receiver:
        job = transfer(api, ready(api), receiver.url)
        api.client.post(f"/jobs/{job['id']}/cancel").raise_for_status()
        receiver.wait_for(1)
    for secret in secrets:
        assert receiver.got[0].verified(secret)["type"] == "job.canceled"


def test_lists_have_pages(api: Api) -> None:
    media = ready(api)
    for number in range(3):
        transfer(api, media, f"{URL}{number}")
    page = api.client.get("/webhooks?limit=2").json()
    rest = api.client.get(f"/webhooks?limit=2&cursor={page['next_cursor']}").json()
    assert [one["url"][-1] for one in page["data"] + rest["data"]] == ["2", "1", "0"]
    assert rest["next_cursor"] is None
    assert api.client.get("/webhooks?cursor=vid_1").status_code == 422
    assert api.client.get("/webhooks?state=lost").status_code == 422


def test_another_keys_webhooks_are_not_there(api: Api) -> None:
    one, other = holder(api), holder(api)
    video = one.post("/videos", content=MP4).json()
    reference = one.post("/references", content=PNG).json()
    body = {"video": video["id"], "looks": [{"reference": reference["id"]}], "webhook": {"url": URL}}
    one.post("/transfer", json=body).raise_for_status()
    (mine,) = one.get("/webhooks").json()["data"]
    assert other.get("/webhooks").json()["data"] == []
    assert one.get(f"/webhooks/{mine['id']}").status_code == 200
    assert other.get(f"/webhooks/{mine['id']}").status_code == 404
    assert other.post(f"/webhooks/{mine['id']}/replay").status_code == 404
    assert one.get("/webhooks/msg_0%00").status_code == 404
    assert one.get("/webhooks/secret").json() != other.get("/webhooks/secret").json()


def test_a_file_named_by_its_url_can_name_a_receiver_too(api: Api) -> None:
    with remote("127.0.0.1") as files, Receiver().listening() as receiver:
        files.answers["/a.mp4"] = file_answer(MP4)
        body = {"url": f"http://127.0.0.1:{files.port}/a.mp4", "webhook": {"url": "https://studio.example:22/"}}
        refused = api.client.post("/videos", json=body)
        assert (refused.json()["code"], refused.json()["errors"][0]["pointer"]) == ("url-not-allowed", "/webhook/url")
        assert files.connections == 0
        medium = api.client.post("/videos", json=body | {"webhook": {"url": receiver.url}}).json()
        make_ready(api.services, medium["id"])
        receiver.wait_for(1)
    said = receiver.got[0].verified(api.client.get("/webhooks/secret").json()["secret"])
    assert (said["type"], said["data"]["media"]) == ("job.succeeded", medium["id"])
