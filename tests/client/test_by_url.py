"""Files that the service fetches, by the real API and a server of somebody else's."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator

import pytest

from pvg_client import ApiError, Client
from tests.service.fixtures import MP4, PNG, Api, api, settings
from tests.service.remote import PUBLIC, Names, Remote, answer, names, public_loopback, remote

__all__ = ["api", "names", "public_loopback", "settings"]


@pytest.fixture
def elsewhere(names: Names, public_loopback: None) -> Iterator[Remote]:
    names.tell("media.example", PUBLIC)
    with remote(PUBLIC) as server:
        server.answers["/clip.mp4"] = answer(MP4 + b"a" * 1000)
        server.answers["/face.png"] = answer(PNG + b"b")
        yield server


def test_the_service_fetches_what_is_at_a_url(api: Api, elsewhere: Remote) -> None:
    site = f"http://media.example:{elsewhere.port}"
    with Client(str(api.client.base_url), retries=0) as client:
        video = client.upload(url=f"{site}/clip.mp4", mask="ycbcr", metadata={"shot": "a7"})
        assert (video.role, video.filename, video.metadata) == ("video", "clip.mp4", {"shot": "a7"})
        assert video.settings["mask"] == "ycbcr"
        assert video.sha256 == hashlib.sha256(MP4 + b"a" * 1000).hexdigest()
        reference = client.upload(url=f"{site}/face.png", role="reference")
        assert (reference.role, reference.content_type) == ("reference", "image/png")
        with pytest.raises(ApiError) as caught:
            client.upload(url=f"{site}/nothing.mp4")
    assert (caught.value.status, caught.value.code) == (422, "fetch-failed")
