"""Webhooks and links for uploads, by the real API and a receiver of somebody else's."""

from __future__ import annotations

import asyncio
import hashlib
import json
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from pvg_client import ApiError, AsyncClient, Client, verify_webhook
from tests.client.lines import Line
from tests.service.api.test_links import use_key
from tests.service.fixtures import MP4, PNG, Api, api, make_ready, make_results, settings
from tests.service.remote import PUBLIC, Names, Remote, answer, names, public_loopback, remote
from tests.waiting import until

__all__ = ["api", "names", "public_loopback", "settings"]


@pytest.fixture
def receiver(names: Names, public_loopback: None) -> Iterator[Remote]:
    names.tell("studio.example", PUBLIC)
    with remote(PUBLIC) as server:
        server.answers["/hook"] = answer(b"", "204 No Content")
        yield server


@pytest.fixture
def url(api: Api) -> str:
    return str(api.client.base_url)


@pytest.fixture
def client(url: str) -> Iterator[Client]:
    with Client(url, retries=2) as made:
        yield made


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    path = tmp_path / "frau lächelt.mp4"
    path.write_bytes(MP4 + bytes(100_000))
    return path


def test_what_was_told_is_listed_told_again_and_signed(client: Client, receiver: Remote, clip: Path) -> None:
    video = client.upload(clip)
    hook = f"http://studio.example:{receiver.port}/hook"
    job = client.transfer(video, reference=video, webhook=hook)
    (waiting,) = client.webhooks(job=job)
    assert (waiting.state, waiting.type, waiting.job, waiting.url) == ("waiting", None, job.id, hook)
    with pytest.raises(ApiError) as caught:
        client.replay(waiting)
    assert caught.value.status == 409
    client.cancel(job)
    told = until(lambda: next(client.webhooks(job=job, state=["delivered"]), None))
    assert told is not None
    assert (told.id, told.type, told.last_status, told.attempts) == (waiting.id, "job.canceled", 204, 1)
    assert told.delivered_at is not None

    secret = client.webhook_secret()
    assert secret.secret not in repr(secret)
    head, _, body = receiver.requests[0].partition(b"\r\n\r\n")
    headers = dict(line.split(": ", 1) for line in head.decode().split("\r\n")[1:])
    assert verify_webhook(body, headers, secret.secret)["data"]["id"] == job.id

    again = client.replay(told.id, idempotency_key="again-1")
    assert again.state == "pending"
    assert client.replay(told, idempotency_key="again-1") == again
    assert until(lambda: client.webhook(told.id).state == "delivered")
    assert len(receiver.requests) == 2
    other = client.rotate_webhook_secret()
    assert other.secret != secret.secret
    assert other.former_valid_until is not None


def test_every_way_to_upload_names_who_is_told(client: Client, clip: Path) -> None:
    hook = "https://studio.example/hook"
    made = [client.upload(clip, webhook=hook), client.upload(clip, role="reference", resume=True, webhook=hook)]
    by_link = client.send_upload(client.upload_link(webhook=hook, mask="ycbcr"), clip)
    assert by_link.media is not None
    for medium in (*made, client.medium(by_link.media)):
        assert [one.url for one in client.webhooks(job=medium.job)] == [hook]


def test_a_result_is_deleted_alone(api: Api, client: Client, clip: Path) -> None:
    video = client.upload(clip)
    make_ready(api.services, video.id)
    job = client.transfer(video, reference=video)
    make_results(api.services, job.id, [b"result"])
    client.delete(client.job(job.id).results[0])
    assert [look.result_gone for look in client.job(job.id).looks] == ["deleted"]
    assert client.medium(video.id).state == "ready"
    client.delete(job)
    assert [one.kind for one in client.jobs()] == ["vectorize"]
    assert client.medium(video.id).state == "ready"


def test_who_has_a_link_uploads_without_a_key(client: Client, url: str, clip: Path) -> None:
    link = client.upload_link(role="reference", max_bytes=1_000_000, expires_in_s=60, metadata={"order": "42"})
    assert httpx.URL(link.url).host == "127.0.0.1"
    assert (client.upload_state(link.id).media, client.upload_state(link).offset_bytes) == (None, 0)
    with Client(url) as somebody:
        sent = somebody.send_upload(link.url, clip)
        assert sent.media is not None
        assert somebody.upload_state(link.url) == sent == client.upload_state(sent)
        assert somebody.send_upload(link.url, clip) == sent
        other = clip.with_name("other.mp4")
        for content in (clip.read_bytes()[:-1] + b"1", MP4):
            other.write_bytes(content)
            with pytest.raises(ApiError) as caught:
                somebody.send_upload(link.url, other)
            assert caught.value.status == 409
        with pytest.raises(ApiError) as caught:
            somebody.send_upload(link.url[:-3] + "AAA", clip)
        assert caught.value.status == 403
    made = client.medium(sent.media)
    assert (made.role, made.filename, made.metadata) == ("reference", clip.name, {"order": "42"})
    assert made.sha256 == hashlib.sha256(clip.read_bytes()).hexdigest()
    small = client.upload_link(max_bytes=1000)
    assert small.max_bytes == 1000
    with pytest.raises(ApiError) as caught:
        client.send_upload(small, clip)
    assert (caught.value.status, caught.value.problem.limit) == (413, 1000)


def test_what_came_by_a_link_is_shown_to_the_key_that_made_it_alone(api: Api, url: str, clip: Path) -> None:
    use_key(api)
    key = api.client.headers["Authorization"].removeprefix("Bearer ")
    with Client(url, key=key) as maker, Client(url) as somebody:
        link = maker.upload_link()
        for sent in (somebody.send_upload(link, clip), maker.send_upload(link, clip), somebody.upload_state(link)):
            assert (sent.media, sent.offset_bytes) == (None, clip.stat().st_size)
        assert maker.upload_state(link.url).media is None
        seen = [maker.upload_state(one).media for one in (link, link.id, sent)]
        assert seen[0] is not None
        assert seen == seen[:1] * 3
        assert maker.medium(seen[0]).filename == clip.name


@pytest.mark.parametrize("lost", ["request", "answer"])
def test_a_file_that_is_broken_off_arrives_by_its_link(client: Client, url: str, clip: Path, lost: str) -> None:
    link = client.upload_link()
    # of the answer a few bytes come through: it was lost, and all has arrived
    line = Line(cuts=1, cut_bytes=50_000) if lost == "request" else _Lost()
    with Client(url, transport=line, retries=2) as somebody:
        sent = somebody.send_upload(link, clip)
    assert sent.size_bytes == clip.stat().st_size
    assert sent.media == client.upload_state(link).media is not None


class _Lost(httpx.HTTPTransport):
    """A line that loses the first answer."""

    lost = 0

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        response = super().handle_request(request)
        if not self.lost:
            self.lost += 1
            response.read()
            response.close()
            raise httpx.ReadError("lost")
        return response


def test_a_file_as_large_as_what_came_by_the_link_meanwhile_has_not_arrived(
    client: Client, url: str, clip: Path
) -> None:
    link = client.upload_link()
    other = clip.with_name("other.mp4")
    other.write_bytes(clip.read_bytes()[:-1] + b"1")

    class Overtaken(httpx.HTTPTransport):
        """A line that breaks before the first request, while somebody else sends a file."""

        sent = None

        def handle_request(self, request: httpx.Request) -> httpx.Response:
            if self.sent is None:
                self.sent = client.send_upload(link, other)
                raise httpx.WriteError("lost")
            return super().handle_request(request)

    line = Overtaken()
    with Client(url, transport=line, retries=2) as somebody, pytest.raises(ApiError) as caught:
        somebody.send_upload(link, clip)
    assert caught.value.status == 409
    assert client.upload_state(link) == line.sent


def test_the_same_for_asyncio(url: str, receiver: Remote, tmp_path: Path) -> None:
    picture = tmp_path / "face.png"
    picture.write_bytes(PNG + b"abc")

    async def main() -> None:
        async with AsyncClient(url) as client:
            link = await client.upload_link(role="reference")
            sent = await client.send_upload(link, picture)
            assert sent == await client.upload_state(link)
            assert sent.media is not None
            video = await client.upload(picture)
            hook = f"http://studio.example:{receiver.port}/hook"
            job = await client.transfer(video, reference=sent.media, webhook=hook)
            (told,) = [one async for one in client.webhooks(job=job)]
            assert await client.webhook(told.id) == told
            await client.cancel(job)
            assert (await client.replay(told)).type == "job.canceled"
            secret = await client.webhook_secret()
            assert (await client.rotate_webhook_secret()).secret != secret.secret
            assert json.loads(json.dumps(told.raw)) == told.raw

    asyncio.run(main())
