from __future__ import annotations

import base64
import hashlib
import os
import re
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial
from typing import Any

import pytest

from service.api.multipart import MAX_FRAMING_BYTES, MAX_OUTSIDE_BYTES, MAX_PARTS, MAX_TEXT_BYTES
from service.api.uploads import clean_name, expected_digest
from service.catalog import VectorSettings, vectorize_request
from service.errors import BadRequestError
from service.settings import Settings
from tests.promises import Drill
from tests.service.fixtures import MP4, PNG, Api, begun, job_of, make_ready, serve
from tests.side_by_side import at_once
from tests.waiting import until

LIMIT = 2 * 1024**2


@pytest.fixture
def small(settings: Settings) -> Iterator[Api]:
    """An API that takes in 2 MiB at most."""
    yield from serve(settings.model_copy(update={"max_upload_bytes": LIMIT}))


def test_a_raw_upload_is_stored_hashed_and_queued(api: Api) -> None:
    content = MP4 + os.urandom(3_000_000)
    answer = api.client.post("/videos", content=content, headers={"content-type": "video/mp4"})
    assert answer.status_code == 202
    body = answer.json()
    assert re.fullmatch(r"vid_[0-9a-f]{32}", body["id"])
    assert answer.headers["location"] == f"/v1/videos/{body['id']}"
    assert body["state"] == "vectorizing"
    assert body["sha256"] == hashlib.sha256(content).hexdigest()
    assert (body["size_bytes"], body["content_type"]) == (len(content), "video/mp4")
    (key,) = api.blobs
    with api.services.storage.local_path(key) as path:
        assert path.read_bytes() == content
    assert api.drafts == []
    job = api.client.get(f"/jobs/{body['job']}").json()
    assert (job["kind"], job["state"], job["media"]) == ("vectorize", "queued", body["id"])


def test_a_form_upload_is_the_same_file(api: Api) -> None:
    content = PNG + os.urandom(2_500_000)
    raw = api.client.post("/references", content=content).json()
    form = api.client.post("/references", files={"file": ("../../Me & you.png", content, "text/plain")})
    assert form.status_code == 200
    assert form.json()["id"] == raw["id"]
    assert len(api.blobs) == 1
    assert api.drafts == []


def test_of_a_file_that_is_sent_again_the_name_that_was_given_last_counts(api: Api) -> None:
    def sent(name: str | None) -> dict[str, Any]:
        headers = {} if name is None else {"content-disposition": f'attachment; filename="{name}"'}
        body: dict[str, Any] = api.client.post("/references", content=PNG, headers=headers).raise_for_status().json()
        return body

    first = sent("a.png")
    assert [sent(name)["filename"] for name in ("b.png", None)] == ["b.png", "b.png"]
    video = api.client.post("/videos", content=MP4).json()["id"]
    form = api.client.post("/transfer", data={"video": video}, files={"reference": ("c.png", PNG)})
    assert form.json()["looks"][0]["reference"] == first["id"]
    assert api.client.get(f"/references/{first['id']}").json()["filename"] == "c.png"


@pytest.mark.parametrize(
    ("header", "name"),
    [
        ('attachment; filename="my clip.mp4"', "my clip.mp4"),
        ("attachment; filename=clip.mp4; x=y", "clip.mp4"),
        (r'attachment; filename="a \"b\".mp4"', 'a "b".mp4'),
        ("attachment; filename=\"a.mp4\"; filename*=UTF-8''kl%C3%A4r.mp4", "klär.mp4"),
        ('attachment; filename="../../clip.mp4"', "clip.mp4"),
        ("attachment; filename*=latin9''%E4.mp4", None),
        ('attachment; filename="klär à la 日本.mp4"'.encode(), "klär à la 日本.mp4"),
        ("attachment; filename=voilà.mp4".encode(), "voilà.mp4"),
        ('attachment; filename="klär.mp4"'.encode("latin-1"), "klär.mp4"),
        ("attachment", None),
        ("", None),
    ],
)
def test_a_raw_upload_may_say_its_name(api: Api, header: str | bytes, name: str | None) -> None:
    sent = header if isinstance(header, bytes) else header.encode()
    body = api.client.post("/videos", content=MP4, headers=[(b"content-disposition", sent)]).json()
    assert body["filename"] == name


def test_the_same_bytes_again_are_the_same_medium(api: Api) -> None:
    first = api.client.post("/videos", content=MP4 + b"1")
    again = api.client.post("/videos", content=MP4 + b"1")
    assert (first.status_code, again.status_code) == (202, 200)
    assert again.json()["id"] == first.json()["id"]
    assert again.json()["job"] == first.json()["job"]
    make_ready(api.services, first.json()["id"])
    ready = api.client.post("/videos", content=MP4 + b"1")
    assert (ready.status_code, ready.json()["state"]) == (200, "ready")
    # a reference is another thing than a video, even with the same bytes
    other = api.client.post("/references", content=MP4 + b"1")
    assert other.status_code == 202
    assert other.json()["id"].startswith("ref_")


def settings_of(api: Api, medium: dict[str, Any]) -> VectorSettings:
    """What the job is asked for."""
    job = job_of(api.services.database, medium["job"])
    return vectorize_request(job).settings


def test_the_same_bytes_with_other_settings_are_another_medium(api: Api) -> None:
    settings = [
        {},
        {"mask": "ycbcr"},
        {"matching": "chain"},
        {"mask": "ycbcr", "matching": "chain"},
        {"input_color": "slog3"},
    ]
    made = [api.client.post("/videos", content=MP4, params=one) for one in settings]
    assert [answer.status_code for answer in made] == [202] * len(settings)
    videos = [answer.json() for answer in made]
    assert len({video["id"] for video in videos}) == len({video["job"] for video in videos}) == len(api.blobs) == 5
    assert len({video["sha256"] for video in videos}) == 1
    for wanted, video in zip(settings, videos, strict=True):
        full = {"mask": "landmarks", "matching": "table", "input_color": "auto"} | wanted
        assert video["settings"] == full
        assert settings_of(api, video) == VectorSettings(**full)
        for again in (
            api.client.post("/videos", content=MP4, params=wanted),
            api.client.post("/videos", content=MP4, params=full),
            api.client.post("/videos", data=full, files={"file": ("clip.mp4", MP4)}),
            api.client.post("/videos", data=wanted, files={"file": ("clip.mp4", MP4)}),
        ):
            assert (again.status_code, again.json()["id"]) == (200, video["id"])
    assert api.client.delete(f"/videos/{videos[1]['id']}?cancel_jobs=true").status_code == 204
    assert [api.client.get(f"/videos/{video['id']}").status_code for video in videos] == [200, 404, 200, 200, 200]
    until(lambda: len(api.blobs) == 4)
    assert api.drafts == []


#: of every setting a value that is not its default
UNUSUAL = {"mask": "ycbcr", "matching": "chain", "input_color": "slog3"}


@pytest.mark.parametrize("name", UNUSUAL)
def test_every_setting_may_be_said_in_the_query_in_a_form_of_pieces_and_of_a_link(api: Api, name: str) -> None:
    assert UNUSUAL.keys() == asdict(VectorSettings()).keys()
    said, tus = {name: UNUSUAL[name]}, {"Tus-Resumable": "1.0.0"}
    meaning = base64.b64encode(UNUSUAL[name].encode()).decode()
    made = [
        api.client.post("/videos", content=MP4, params=said).json(),
        api.client.post("/videos/form", data=said, files={"file": ("clip.mp4", MP4)}).json(),
    ]
    pieces = tus | {"Upload-Length": str(len(MP4)), "Upload-Metadata": f"{name} {meaning}"}
    in_pieces = api.client.post("/uploads", headers=pieces).json()["id"]
    link = api.client.post("/uploads/link", json=said).json()["id"]
    waiting = {one["id"]: one for one in api.client.get("/uploads").json()["data"]}
    made += [waiting[in_pieces], waiting[link]]
    assert [one["settings"] for one in made] == [asdict(VectorSettings()) | said] * 4
    if name != "matching":
        reference = api.client.post("/references", content=PNG, params=said).json()
        assert reference["settings"] == asdict(VectorSettings()) | said


def test_a_reference_has_a_mask_too(api: Api) -> None:
    one, other = (api.client.post("/references", content=PNG, params=p).json() for p in ({}, {"mask": "ycbcr"}))
    assert one["id"] != other["id"]
    assert settings_of(api, other) == VectorSettings(mask="ycbcr")
    form = api.client.post("/references", data={"matching": "chain"}, files={"file": ("a.png", PNG)})
    assert form.status_code == 400


@pytest.mark.parametrize(
    ("query", "fields", "pointer"),
    [
        ({"mask": "skin"}, {}, "/query/mask"),
        ({"matching": ""}, {}, "/query/matching"),
        ({}, {"mask": "skin"}, "/mask"),
        ({}, {"matching": "none"}, "/matching"),
        ({"mask": "ycbcr"}, {"mask": "ycbcr"}, "/mask"),
    ],
)
def test_bad_settings_are_named_and_nothing_is_kept(
    api: Api, query: dict[str, str], fields: dict[str, str], pointer: str
) -> None:
    answer = api.client.post("/videos", params=query, data=fields, files={"file": ("clip.mp4", MP4)})
    assert (answer.status_code, answer.json()["code"]) == (422, "validation-failed")
    assert [error["pointer"] for error in answer.json()["errors"]] == [pointer]
    assert api.blobs == []
    assert api.drafts == []


def test_a_failed_medium_is_tried_again_with_its_own_settings(api: Api) -> None:
    video = api.client.post("/videos?mask=ycbcr", content=MP4).json()
    api.client.post(f"/jobs/{video['job']}/cancel")
    again = api.client.post("/videos?mask=ycbcr", content=MP4).json()
    assert again["id"] == video["id"]
    assert again["job"] != video["job"]
    assert settings_of(api, again) == VectorSettings(mask="ycbcr")


def test_the_settings_stand_in_the_schema(api: Api) -> None:
    paths = api.client.get("/openapi.json").json()["paths"]
    assert {one["name"] for one in paths["/v1/videos"]["post"]["parameters"]} == {
        *("mask", "matching", "input_color", "metadata", "webhook", "idempotency-key")
    }
    form = paths["/v1/videos/form"]["post"]["requestBody"]["content"]["multipart/form-data"]["schema"]["properties"]
    assert form["mask"]["enum"] == ["landmarks", "ycbcr"]
    assert form["matching"]["enum"] == ["table", "chain"]


def test_many_uploads_of_the_same_bytes_at_once_make_one_medium(api: Api) -> None:
    content = MP4 + os.urandom(200_000)
    answers = at_once([partial(api.client.post, "/videos", content=content)] * 8)
    assert sorted(answer.status_code for answer in answers) == [200] * 7 + [202]
    assert len({answer.json()["id"] for answer in answers}) == 1
    until(lambda: len(api.blobs) == 1)
    assert api.drafts == []


@pytest.mark.parametrize("content", [b"", b"hello", b"#EXTM3U\n", b"<svg/>", b"GIF89a" + b"\0" * 100])
def test_what_is_no_media_is_refused_at_the_door(api: Api, content: bytes) -> None:
    for answer in (
        api.client.post("/videos", content=content, headers={"content-type": "video/mp4"}),
        api.client.post("/videos", files={"file": ("clip.mp4", content, "video/mp4")}),
    ):
        assert answer.status_code == 415
        assert answer.json()["code"] == "unsupported-media-type"
    assert api.blobs == []
    assert api.drafts == []
    assert api.client.get("/videos").json() == {"data": [], "next_cursor": None}


FORM = b'--x\r\nContent-Disposition: form-data; name="file"; filename="clip.mp4"\r\n\r\n'


@pytest.mark.parametrize("call", ["POST /videos", "POST /videos/form", "PUT by a link"])
def test_what_is_no_media_is_refused_after_its_first_bytes(api: Api, call: str) -> None:
    kind, frame = "video/mp4", b""
    if call.endswith("/form"):
        kind, frame = "multipart/form-data; boundary=x", FORM
    if call.endswith("link"):
        call = "PUT " + api.client.post("/uploads/link", json={}).json()["url"]
    sent = frame + b"<html>" + b"x" * 5000
    assert begun(api, call, sent, 1_000_000_000, within_s=60, **{"Content-Type": kind}) == 415
    assert (api.blobs, api.drafts) == ([], [])


def test_a_wrong_digest_is_refused_and_a_right_one_taken(api: Api) -> None:
    content = PNG + b"x"
    right = base64.b64encode(hashlib.sha256(content).digest()).decode()
    wrong = base64.b64encode(hashlib.sha256(b"other").digest()).decode()
    refused = api.client.post("/references", content=content, headers={"repr-digest": f"sha-256=:{wrong}:"})
    assert refused.status_code == 400
    assert api.blobs == []
    taken = api.client.post("/references", content=content, headers={"repr-digest": f"sha-256=:{right}:"})
    assert taken.status_code == 202


EMPTY = base64.b64encode(hashlib.sha256(b"").digest()).decode()


@pytest.mark.parametrize(
    "header",
    [
        "sha-256=abc",
        "sha-256=:abc",
        f"sha-256={EMPTY}",
        f'sha-256="{EMPTY}"',
        f"SHA-256=:{EMPTY}:",
        "sha-256=:YWJj:",  # three bytes
        "sha-256=:%%%%:",
        f"sha-256=:{EMPTY}:, x",
        "sha-256",
        "",
        ",",
    ],
)
def test_a_malformed_digest_is_refused(api: Api, header: str) -> None:
    answer = api.client.post("/references", content=PNG, headers={"repr-digest": header})
    assert (answer.status_code, answer.json()["code"]) == (400, "malformed")
    assert api.blobs == api.drafts == []


def test_a_long_malformed_digest_is_refused_at_once() -> None:
    for parameters in (";a= " * 3000, "; a" * 3000, ";a" + " " * 12_000, ";a=" + " " * 12_000):
        began = time.thread_time()
        with pytest.raises(BadRequestError):
            expected_digest([f'sha-256=::{parameters}"'])
        assert time.thread_time() - began < 1


def test_digests_of_other_kinds_and_of_several_lines_are_read(api: Api) -> None:
    right = base64.b64encode(hashlib.sha256(PNG).digest()).decode()
    for lines in (
        ["sha-512=:YWJj:"],
        ["sha-512=:YWJj:", f"sha-256=:{right}:"],
        [f"md5=:YWJj:;a=1 ;\tb; c= , sha-256=:{right}:"],
    ):
        answer = api.client.post("/references", content=PNG, headers=[("repr-digest", line) for line in lines])
        assert answer.status_code in {200, 202}
    wrong = [("repr-digest", "sha-512=:YWJj:"), ("repr-digest", f"sha-256=:{EMPTY}:")]
    assert api.client.post("/references", content=PNG, headers=wrong).status_code == 400


def test_a_digest_of_a_form_is_refused_and_one_of_json_is_checked(api: Api) -> None:
    header = {"repr-digest": f"sha-256=:{EMPTY}:"}
    for path in ("/references", "/videos", "/transfer"):
        answer = api.client.post(path, files={"file": ("a.png", PNG)}, headers=header)
        assert (answer.status_code, answer.json()["code"]) == (400, "malformed")
        assert "form" in answer.json()["detail"]
    for path in ("/transfer", "/swap"):
        answer = api.client.post(path, json={}, headers=header)
        assert (answer.status_code, answer.json()["code"]) == (400, "malformed")
    assert api.blobs == api.drafts == []


def test_a_file_at_the_limit_is_taken_and_one_byte_more_is_not(small: Api) -> None:
    content = MP4 + bytes(LIMIT - len(MP4))
    assert small.client.post("/videos", files={"file": ("a.mp4", content)}).status_code == 202
    for answer in (
        small.client.post("/videos", content=content + b"1"),
        small.client.post("/videos", files={"file": ("a.mp4", content + b"1")}),
        small.client.post("/videos", files={"file": ("a.mp4", content + bytes(MAX_FRAMING_BYTES + 1))}),
    ):
        assert answer.status_code == 413
        assert answer.json()["limit"] == LIMIT
        assert str(LIMIT) in answer.json()["detail"]
        assert answer.json()["code"] == "too-large"
    assert len(small.blobs) == 1
    assert small.drafts == []


def send_until_answered(api: Api, head: str, body: bytes, enough: int) -> tuple[str, int]:
    """Send a body piece by piece until the server answers; (answer, bytes of the body sent).

    Once more than ``enough`` is sent each further piece waits for the answer, for as long as a slow machine takes.
    """
    sent = 0
    with socket.create_connection(api.address, timeout=60) as connection:
        connection.sendall(head.encode() + b"\r\n\r\n")
        while sent < len(body):
            connection.settimeout(0.02 if sent <= enough else 20)
            try:
                answer = connection.recv(65536)
                return answer.decode(), sent
            except TimeoutError:
                pass
            except ConnectionResetError:
                return "", sent
            try:
                data = piece = body[sent : sent + 64 * 1024]
                if "chunked" in head:
                    data = f"{len(data):x}\r\n".encode() + data + b"\r\n"
                connection.settimeout(60)
                connection.sendall(data)
                sent += len(piece)
            except (TimeoutError, BrokenPipeError, ConnectionResetError):
                break
        connection.settimeout(60)
        return connection.recv(65536).decode(), sent


@pytest.mark.embedded  # while a connection to PostgreSQL is made, what is sent fills the socket's buffers, unread
def test_a_declared_oversize_is_refused_before_any_of_it_is_read(small: Api, promise: Callable[..., Drill]) -> None:
    drill = promise("R11", wanted="declared: 413 before the limit + 1 MiB is read")
    head = "POST /videos HTTP/1.1\r\nHost: localhost\r\nContent-Type: video/mp4\r\nContent-Length: 5000000000"
    answer, sent = send_until_answered(small, head, MP4 + bytes(10 * LIMIT), enough=0)
    assert answer.startswith("HTTP/1.1 413 ")
    assert "connection: close" in answer.lower()
    drill.measured = f"{answer[9:12]} after {sent / 1024:.0f} KiB of 5 GB"
    assert sent <= 256 * 1024


def test_an_undeclared_oversize_is_cut_off_within_a_mebibyte_of_the_limit(
    small: Api, promise: Callable[..., Drill]
) -> None:
    drill = promise("R11", wanted="of no length: 413 before the limit + 1 MiB is read")
    head = "POST /videos HTTP/1.1\r\nHost: localhost\r\nContent-Type: video/mp4\r\nTransfer-Encoding: chunked"
    answer, sent = send_until_answered(small, head, MP4 + bytes(10 * LIMIT), enough=LIMIT)
    assert answer.startswith("HTTP/1.1 413 ")
    drill.measured = f"{answer[9:12]} after the limit + {(sent - LIMIT) / 1024:.0f} KiB"
    # what fits into socket buffers may have left us without having been read
    assert sent <= LIMIT + 1024**2
    assert small.drafts == []


FILE = b'--x\r\nContent-Disposition: form-data; name="file"; filename="a.mp4"\r\n\r\n' + MP4 + b"\r\n"
FIELD = b'--x\r\nContent-Disposition: form-data; name="a"\r\n\r\n' + b"b" * 60_000 + b"\r\n"


@pytest.mark.parametrize(
    ("body", "enough"),
    [
        pytest.param(FILE + b"--x--\r\n" + bytes(10 * LIMIT), 4 * MAX_OUTSIDE_BYTES, id="after its end"),
        pytest.param(b"\r\n" * 5 * LIMIT, 4 * MAX_OUTSIDE_BYTES, id="before its beginning"),
        pytest.param(FILE + FIELD * 60, LIMIT + MAX_FRAMING_BYTES, id="in fields"),
    ],
)
def test_a_form_of_no_length_is_cut_off_within_a_mebibyte_of_the_limit_wherever_its_bytes_stand(
    small: Api, promise: Callable[..., Drill], body: bytes, enough: int
) -> None:
    drill = promise("R11", wanted="a form of no length: 413 before the limit + 1 MiB is read")
    head = (
        "POST /videos HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n"
        "Content-Type: multipart/form-data; boundary=x"
    )
    answer, sent = send_until_answered(small, head, body, enough)
    assert answer.startswith("HTTP/1.1 413 ")
    drill.measured = f"{answer[9:12]} after {sent / 1024:.0f} KiB, at a limit of {LIMIT / 1024:.0f} KiB"
    assert sent <= LIMIT + 1024**2
    assert small.blobs == small.drafts == []


@pytest.mark.parametrize(
    "before",
    [b"", b"\r\n" * 100, b"a form in parts\r\n--\r\n\r--x\r\n", b"--\r\n" * 10_000],
    ids=["nothing", "empty lines", "text", "much"],
)
def test_a_form_may_have_a_little_before_and_after_its_parts(api: Api, before: bytes) -> None:
    body = before + FILE + b"--x--\r\n" + bytes(10_000)
    form = {"content-type": "multipart/form-data; boundary=x"}
    assert api.client.post("/videos", content=body, headers=form).status_code == 202
    start = max(1, len(before) - 10)  # byte by byte where its first part begins
    pieces = [body[:start], *(body[i : i + 1] for i in range(start, start + 30)), body[start + 30 :]]
    with socket.create_connection(api.address, timeout=60) as connection:
        head = "POST /videos HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nTransfer-Encoding: chunked\r\n"
        connection.sendall(f"{head}Content-Type: {form['content-type']}\r\n\r\n".encode())
        for piece in (*pieces, b""):
            connection.sendall(b"%x\r\n%s\r\n" % (len(piece), piece))
            time.sleep(0.002)  # each comes alone
        assert connection.recv(15) == b"HTTP/1.1 200 OK"


def test_a_client_that_goes_away_leaves_nothing(api: Api) -> None:
    with socket.create_connection(api.address, timeout=60) as connection:
        head = "POST /videos HTTP/1.1\r\nHost: localhost\r\nContent-Type: video/mp4\r\nContent-Length: 3000000\r\n\r\n"
        connection.sendall(head.encode() + MP4 + bytes(1_500_000))
        until(lambda: api.drafts)
    until(lambda: api.drafts == [])
    assert api.blobs == []


@pytest.mark.parametrize(
    ("content_type", "body"),
    [
        ("multipart/form-data", b"--x\r\n"),
        ("multipart/form-data; boundary=x", b""),
        ("multipart/form-data; boundary=x", b"garbage"),
        (
            "multipart/form-data; boundary=x",
            b'--x\r\nContent-Disposition: form-data; name="file"; filename="a"\r\n\r\n',
        ),
        ("multipart/form-data; boundary=x", b"--x\r\nContent-Disposition: form-data\r\n\r\nabc\r\n--x--\r\n"),
        ("multipart/form-data; boundary=x", b"--x\r\nA: " + b"b" * 20_000 + b"\r\n\r\n\r\n--x--\r\n"),
        ("multipart/form-data; boundary=x", b"--x\r\n" + b"A: b\r\n" * 9 + b"\r\n\r\n--x--\r\n"),
        ("multipart/form-data; boundary=" + "x" * 100, b"--" + b"x" * 100 + b"--\r\n"),
    ],
)
def test_malformed_forms_are_refused(api: Api, content_type: str, body: bytes) -> None:
    answer = api.client.post("/videos", content=body, headers={"content-type": content_type})
    assert answer.status_code == 400
    assert answer.json()["code"] == "malformed"
    assert api.drafts == []


def test_forms_with_anything_else_are_refused(api: Api) -> None:
    file = ("a.png", PNG)
    for files, data in (
        ({"other": file}, {}),
        ({"file": file}, {"extra": "1"}),
        ([("file", file), ("file", file)], {}),
    ):
        assert api.client.post("/videos", files=files, data=data).status_code == 400
    assert api.blobs == []
    assert api.drafts == []


def test_a_form_has_no_more_parts_than_are_read(api: Api) -> None:
    for more, detail in ((0, None), (1, f"the multipart body has more than {MAX_PARTS} parts")):
        data = {"nobody asks": ["x"] * (MAX_PARTS - 1 + more)}
        answer = api.client.post("/videos", files={"file": ("a.png", PNG)}, data=data)
        assert answer.status_code == 400
        assert (answer.json()["detail"] == detail) == (detail is not None)
    assert (api.blobs, api.drafts) == ([], [])


@pytest.mark.parametrize("others", [0, 1, 20])
def test_the_text_of_a_form_has_no_more_bytes_than_are_kept(api: Api, others: int) -> None:
    size = MAX_TEXT_BYTES - len("webhook") - others * len("metadata" + "a:b")
    answers = [
        api.client.post(
            "/videos",
            files={"file": ("a.png", PNG)},
            data={"metadata": ["a:b"] * others, "webhook": "x" * (size + more)},
        )
        for more in (0, 1)
    ]
    assert [answer.status_code for answer in answers] == [422, 413]  # the former is no address
    problem = answers[1].json()
    assert (problem["code"], problem["limit"], problem["unit"]) == ("too-large", MAX_TEXT_BYTES, "bytes")
    assert "'webhook'" in problem["detail"]
    assert (api.blobs, api.drafts) == ([], [])


def test_a_file_that_is_sent_as_a_text_is_told_what_makes_it_one(api: Api) -> None:
    """No limit of files is what it is over."""
    part = b'--x\r\nContent-Disposition: form-data; name="file"\r\n\r\n%s\r\n--x--\r\n'
    form = {"content-type": "multipart/form-data; boundary=x"}
    answers = [api.client.post("/videos", content=part % content, headers=form) for content in (b"a", MP4 * 10_000)]
    assert [answer.status_code for answer in answers] == [400, 413]
    assert "is a text; curl sends a file" in answers[0].json()["detail"]
    assert "a file's part has a filename" in answers[1].json()["detail"]


def test_file_names_are_shown_without_folders_and_control_characters() -> None:
    assert clean_name("../../etc/passwd") == "passwd"
    assert clean_name("C:\\clips\\a\x00\x1b[31m.mp4") == "a[31m.mp4"
    assert clean_name("x" * 500 + ".mp4") == "x" * 196 + ".mp4"
    assert clean_name("") is None
    assert clean_name("/") is None
