from __future__ import annotations

import base64
import hashlib
import os

import pytest

from service.catalog import results
from tests.service.api.test_media import transfer, upload
from tests.service.fixtures import Api, make_ready, make_results

CONTENT = os.urandom(1_000_000)


@pytest.fixture
def path(api: Api) -> str:
    video = upload(api, "/videos")
    make_ready(api.services, video["id"])
    (result_id,) = make_results(api.services, transfer(api, video["id"], video["id"])["id"], [CONTENT])
    return f"/results/{result_id}"


def test_the_whole_file_carries_its_hash(api: Api, path: str) -> None:
    answer = api.client.get(path)
    digest = hashlib.sha256(CONTENT)
    assert answer.status_code == 200
    assert answer.content == CONTENT
    assert answer.headers["etag"] == f'"{digest.hexdigest()}"'
    assert answer.headers["repr-digest"] == f"sha-256=:{base64.b64encode(digest.digest()).decode()}:"
    assert answer.headers["content-type"] == "video/mp4"
    assert answer.headers["content-length"] == str(len(CONTENT))
    assert answer.headers["accept-ranges"] == "bytes"
    assert "clip" in answer.headers["content-disposition"]


def test_ranges_are_parts_of_the_file(api: Api, path: str) -> None:
    for header, start, end in (
        ("bytes=0-0", 0, 1),
        ("bytes=1000-499999", 1000, 500_000),
        ("bytes=999999-", 999_999, 1_000_000),
        ("bytes=-10", 999_990, 1_000_000),
    ):
        answer = api.client.get(path, headers={"range": header})
        assert answer.status_code == 206
        assert answer.content == CONTENT[start:end]
        assert answer.headers["content-range"] == f"bytes {start}-{end - 1}/1000000"
    outside = api.client.get(path, headers={"range": "bytes=1000000-"})
    assert outside.status_code == 416
    assert outside.headers["content-range"] == "bytes */1000000"
    assert outside.json()["type"] == "range-not-satisfiable"


def test_a_download_goes_on_only_with_the_same_file(api: Api, path: str) -> None:
    etag = api.client.get(path).headers["etag"]
    same = api.client.get(path, headers={"range": "bytes=5-9", "if-range": etag})
    other = api.client.get(path, headers={"range": "bytes=5-9", "if-range": '"other"'})
    assert (same.status_code, other.status_code) == (206, 200)


def test_a_known_file_is_not_sent_again(api: Api, path: str) -> None:
    etag = api.client.get(path).headers["etag"]
    answer = api.client.get(path, headers={"if-none-match": etag})
    assert (answer.status_code, answer.content) == (304, b"")
    assert answer.headers["etag"] == etag


def test_head_has_the_headers_only(api: Api, path: str) -> None:
    answer = api.client.head(path)
    assert (answer.status_code, answer.content) == (200, b"")
    assert answer.headers["content-length"] == "1000000"


def test_unknown_results_are_not_found_and_expired_ones_are_gone(api: Api, path: str) -> None:
    assert api.client.get(f"/results/res_{'0' * 32}").status_code == 404
    with api.services.database.write() as session:
        result = results.get(session, path.removeprefix("/results/"))
        assert result is not None
        key = results.drop_bytes(session, result)
    assert key is not None
    api.services.storage.delete(key)
    answer = api.client.get(path)
    assert (answer.status_code, answer.json()["type"]) == (410, "gone")
