from __future__ import annotations

import hashlib
import socket
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime, timedelta
from email.utils import parsedate_to_datetime
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import httpx
import pytest
from pydantic import ValidationError
from sqlalchemy import update

from service.api import rates
from service.api.advice import ADVICE
from service.catalog import Key, Media, keys, utc_now
from service.settings import Settings
from tests.service.fixtures import MP4, PNG, Api, make_ready, make_results, serve
from tests.service.s3 import S3
from tests.waiting import until

FILE = b"the file of a result"
LIMITS = keys.Limits(requests_per_minute=600, active_jobs=10, stored_bytes=1_000_000)


@pytest.fixture
def stranger(api: Api) -> Iterator[httpx.Client]:
    """A browser: no key."""
    with httpx.Client(base_url=api.client.base_url, timeout=60) as client:
        yield client


def use_key(api: Api, name: str = "studio") -> str:
    """From now on the client has a key; its id."""
    with api.services.background.write() as session:
        key, text = keys.create(session, name, LIMITS, now=api.services.database.now())
    api.client.headers["Authorization"] = f"Bearer {text}"
    return key.id


def make_result(api: Api, content: bytes = FILE) -> str:
    """A result of the client's own, with a cube of a second person."""
    video = api.client.post("/videos", content=MP4 + content).json()
    make_ready(api.services, video["id"])
    job = api.client.post("/transfer", json={"video": video["id"], "looks": [{"reference": video["id"]}]}).json()
    return make_results(api.services, job["id"], [content], parts=[("look.cube", 2, b"cube")])[0]


def test_a_result_is_had_by_a_link_without_a_key(api: Api, stranger: httpx.Client) -> None:
    use_key(api)
    result = make_result(api)
    assert stranger.get(f"/results/{result}").status_code == 401
    assert stranger.post(f"/results/{result}/link").status_code == 401
    made = api.client.post(f"/results/{result}/link")
    assert made.status_code == 200, made.text
    url = made.json()["url"]
    assert url.startswith(f"/v1/results/{result}?")
    left = datetime.fromisoformat(made.json()["expires_at"]) - api.services.database.now()
    assert timedelta(seconds=900) < left <= timedelta(seconds=1000)  # the result is kept for 1000 s
    whole = stranger.get(url)
    assert (whole.status_code, whole.content) == (200, FILE)
    part = stranger.get(url, headers={"Range": "bytes=4-7"})
    assert (part.status_code, part.content) == (206, FILE[4:8])
    # a browser leaves nothing of it among its files
    assert {one.headers["cache-control"] for one in (whole, part)} == {"no-store"}
    assert api.client.get(f"/results/{result}").headers["cache-control"] == "private, no-cache"
    assert stranger.get(url, headers={"If-None-Match": whole.headers["etag"]}).status_code == 304
    assert stranger.head(url).headers["content-length"] == str(len(FILE))
    cube = api.client.post(
        f"/results/{result}/link", json={"part": "look.cube", "person": 2, "expires_in_s": 60}
    ).json()
    assert stranger.get(cube["url"]).content == b"cube"


def test_a_person_is_of_a_part(api: Api) -> None:
    address = f"/results/{make_result(api)}/link"
    refused = api.client.post(address, json={"person": 7})
    errors = [{"pointer": "/person", "detail": "only a part has persons: give `part`, matte or look.cube"}]
    assert (refused.status_code, refused.json()["errors"]) == (422, errors)
    wrong = api.client.post(address, json={"part": "mask", "person": 7})
    assert [one["pointer"] for one in wrong.json()["errors"]] == ["/part"]
    assert api.client.post(address, json={"person": 1}).status_code == 200  # the default, said


def test_a_link_is_for_what_it_was_made_for(api: Api, stranger: httpx.Client) -> None:
    use_key(api)
    first, second = (make_result(api, content) for content in (FILE, b"another"))
    url = api.client.post(f"/results/{first}/link", json={"expires_in_s": 60}).json()["url"]
    query = {name: values[0] for name, values in parse_qs(urlsplit(url).query).items()}
    wrong = [
        f"/results/{second}?{urlsplit(url).query}",
        f"/results/{first}/look.cube?{urlsplit(url).query}&person=2",
        url.replace(query["expires"], str(int(query["expires"]) + 1)),
        url.replace(query["expires"], "x"),
        url[:-1] + ("A" if url[-1] != "A" else "B"),
        f"/results/{first}?signature={query['signature']}",
        f"/results/{first}?signature=",
        f"/uploads/{first}?{urlsplit(url).query}",
        f"/results/res_0?{urlsplit(url).query}",
    ]
    assert {stranger.get(one).status_code for one in wrong} == {403}
    # nor for anything else
    assert stranger.get(f"/videos?{urlsplit(url).query}").status_code == 401
    assert stranger.post(f"/results/{first}/link?{urlsplit(url).query}").status_code == 401


def test_a_link_ends_with_its_time_its_result_and_its_key(api: Api, stranger: httpx.Client) -> None:
    owner = use_key(api)
    result = make_result(api)
    url = api.client.post(f"/results/{result}/link").json()["url"]
    now = api.services.database.now()
    with api.services.database.read() as session:
        seal = keys.seals(session, owner, now=now)[0]
    old = api.services.signer.sign("result", result, by=owner, seal=seal, expires_at=now - timedelta(seconds=2))
    gone = stranger.get(f"/results/{result}", params=old)
    assert (gone.status_code, gone.json()["code"]) == (410, "gone")
    with api.services.background.write() as session:
        key = keys.by_name(session, owner)
        assert key is not None
        assert keys.revoke(session, key, now=now)
    assert stranger.get(url).status_code == 403


def test_links_end_with_the_secret_of_their_key(api: Api, stranger: httpx.Client) -> None:
    owner = use_key(api)
    result = make_result(api)
    urls = [api.client.post(f"/results/{result}/link").json()["url"], upload_link(api)]
    parts = api.client.post(f"/results/{result}/link", json={"part": "look.cube", "person": 2}).json()["url"]
    assert [stranger.get(url).status_code for url in (*urls, parts)] == [200] * 3
    with api.services.background.write() as session:
        key = keys.get(session, owner)
        assert key is not None
        api.client.headers["Authorization"] = f"Bearer {keys.rotate(key)}"
    assert [stranger.get(url).status_code for url in (*urls, parts)] == [403] * 3
    assert stranger.put(urls[1], content=MP4).status_code == 403
    for url in (api.client.post(f"/results/{result}/link").json()["url"], upload_link(api)):
        assert stranger.get(url).status_code == 200


def test_links_and_requests_of_a_former_secret_are_good_while_it_is(api: Api, stranger: httpx.Client) -> None:
    owner = use_key(api)
    result = make_result(api)
    urls = [api.client.post(f"/results/{result}/link").json()["url"], upload_link(api)]
    until = api.services.database.now() + timedelta(seconds=60)
    with api.services.background.write() as session:
        key = keys.get(session, owner)
        assert key is not None
        text = keys.rotate(key, former_until=until)
    assert [stranger.get(url).status_code for url in urls] == [200] * 2
    urls.append(api.client.post(f"/results/{result}/link").json()["url"])  # with the former one, by the present one
    with api.services.background.write() as session:
        session.get_one(Key, owner).former_until = api.services.database.now()
    assert api.client.get("/usage").status_code == 401
    assert [stranger.get(url).status_code for url in urls] == [403, 403, 200]
    api.client.headers["Authorization"] = f"Bearer {text}"
    assert api.client.get("/usage").status_code == 200


@pytest.mark.parametrize("by", ["key_%00", "key_" + "0" * 32, "key_" + "g" * 32, "%ed%a0%80"])
def test_a_link_of_no_key_there_is_is_none(api: Api, stranger: httpx.Client, by: str) -> None:
    use_key(api)
    assert stranger.get(f"/uploads/upl_{'0' * 32}?expires=9999999999&by={by}&signature=a").status_code == 403


@pytest.mark.parametrize("revoked", [True, False])
def test_no_link_goes_to_another_key_with_what_it_is_for(api: Api, stranger: httpx.Client, *, revoked: bool) -> None:
    former = use_key(api, "former")
    result = make_result(api)
    urls = [api.client.post(f"/results/{result}/link").json()["url"], upload_link(api)]
    assert [stranger.get(url).status_code for url in urls] == [200, 200]
    heir = use_key(api, "heir")
    with api.services.background.write() as session:
        old, new = keys.by_name(session, former), keys.by_name(session, heir)
        assert old is not None
        assert new is not None
        if revoked:
            keys.revoke(session, old, now=api.services.database.now())
        assert keys.adopt(session, new, owner=former) == (1, 0)
    altered = [url.replace(former, heir) for url in urls]
    assert [stranger.get(url).status_code for url in urls + altered] == [403] * 4
    assert stranger.get(api.client.post(f"/results/{result}/link").json()["url"]).status_code == 200


def test_a_link_of_before_there_were_keys_ends_with_the_first(api: Api, stranger: httpx.Client) -> None:
    result = make_result(api)
    url = api.client.post(f"/results/{result}/link").json()["url"]
    assert stranger.get(url).status_code == 200
    owner = use_key(api)
    assert stranger.get(url).status_code == 403
    with api.services.background.write() as session:
        key = keys.get(session, owner)
        assert key is not None
        keys.adopt(session, key)
    assert stranger.get(url).status_code == 403


def test_the_link_of_a_deleted_video_leads_nowhere(api: Api, stranger: httpx.Client) -> None:
    result = make_result(api)
    url = api.client.post(f"/results/{result}/link").json()["url"]
    for video in api.client.get("/videos").json()["data"]:
        assert api.client.delete(f"/videos/{video['id']}").status_code == 204
    assert stranger.get(url).status_code == 404


def test_what_to_do_about_a_link_that_no_longer_opens_is_said() -> None:
    for code in ("gone", "forbidden"):
        meaning, advice = ADVICE[code]
        assert "link" in meaning
        assert "another" in advice


def test_links_of_one_api_open_at_another(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path / "data", reap_interval_s=3600)
    for api in serve(settings):
        result = make_result(api)
        url = api.client.post(f"/results/{result}/link").json()["url"]
    assert (tmp_path / "data" / "link-secret").stat().st_mode & 0o777 == 0o600
    for api in serve(settings):
        assert api.client.get(url).status_code == 200
    for api in serve(settings.model_copy(update={"link_secret": Settings(link_secret="a" * 32).link_secret})):
        assert api.client.get(url).status_code == 403


def test_a_short_secret_is_refused_and_none_is_shown() -> None:
    with pytest.raises(ValidationError, match="at least 32"):
        Settings(link_secret="short")
    assert "a" * 32 not in repr(Settings(link_secret="a" * 32))


def test_a_cube_has_the_name_by_which_it_is_asked_for_too(api: Api, stranger: httpx.Client) -> None:
    result = make_result(api)
    url = api.client.post(f"/results/{result}/link", json={"part": "cube", "person": 2}).json()["url"]
    assert url.startswith(f"/v1/results/{result}/look.cube?")
    for one in (url, url.replace("/look.cube?", "/cube?"), f"/results/{result}/cube?person=2"):
        assert stranger.get(one).content == b"cube"


def test_what_a_link_may_not_be(api: Api) -> None:
    result = make_result(api)
    for wanted in ({"expires_in_s": 0}, {"expires_in_s": 10**9}, {"part": "all"}, {"speed": 1}):
        assert api.client.post(f"/results/{result}/link", json=wanted).status_code == 422
    assert api.client.post(f"/results/{result}/link", json={"part": "matte"}).status_code == 404
    assert api.client.post("/results/res_0/link").status_code == 404
    assert api.client.post("/uploads/link", json={"role": "reference", "matching": "chain"}).status_code == 422
    key = {"Idempotency-Key": "a"}
    first, second = (api.client.post(f"/results/{result}/link", headers=key) for _ in range(2))
    assert first.json() == second.json()


def test_what_is_sent_to_make_a_link_is_read_or_refused(api: Api) -> None:
    call, wanted = f"/results/{make_result(api)}/link", b'{"expires_in_s": 60}'
    typed, text = {"content-type": "application/json"}, {"content-type": "text/plain"}
    for content, headers in ((wanted, {}), (iter([wanted]), {}), (iter([b""]), {}), (wanted, text)):
        answer = api.client.post(call, content=content, headers=headers)
        assert (answer.status_code, answer.json()["code"]) == (415, "unsupported-media-type")
    key = {"Idempotency-Key": "a"}
    made = api.client.post(call, content=wanted, headers=typed | key)
    for content in (wanted, iter([wanted])):
        again = api.client.post(call, content=content, headers=typed | key)
        assert (again.json(), again.headers["idempotent-replayed"]) == (made.json(), "true")
    # nothing at all stands for the defaults, whatever type it has
    for headers in ({}, typed):
        assert api.client.post(call, headers=headers).status_code == 200
        other = api.client.post(call, headers=headers | key)
        assert (other.status_code, other.json()["code"]) == (422, "idempotency-key-reused")


def test_links_may_lead_to_the_object_store(tmp_path: Path, bucket: S3) -> None:
    settings = Settings(
        data_dir=tmp_path / "data", reap_interval_s=3600, storage_url=bucket.storage_url, links_to_store=True
    )
    for api in serve(settings):
        result = make_result(api)
        url = api.client.post(f"/results/{result}/link", json={"expires_in_s": 60}).json()["url"]
        assert url.startswith(bucket.url)
        query = parse_qs(urlsplit(url).query)
        assert query["X-Amz-Expires"] == ["60"]
        assert query["X-Amz-Signature"]
        assert "secret" not in url
        assert httpx.get(url, timeout=60).content == FILE
        part = httpx.get(url, headers={"Range": "bytes=4-7"}, timeout=60)
        assert (part.status_code, part.content) == (206, FILE[4:8])
        with api.services.background.write() as session:
            session.execute(update(Media).values(expires_at=api.services.database.now() + timedelta(seconds=50)))
        url = api.client.post(f"/results/{result}/link", json={"expires_in_s": 60}).json()["url"]
        assert 0 < int(parse_qs(urlsplit(url).query)["X-Amz-Expires"][0]) < 50


# uploads


def upload_link(api: Api, **wanted: object) -> str:
    made = api.client.post("/uploads/link", json=wanted)
    assert made.status_code == 201, made.text
    return str(made.json()["url"])


def medium_of(api: Api, url: str) -> str:
    """What has come by a link, as its maker sees it."""
    return str(api.client.get(urlsplit(url).path).json()["media"])


def test_one_file_is_uploaded_by_a_link_without_a_key(api: Api, stranger: httpx.Client) -> None:
    use_key(api)
    data = PNG + b"a" * 1000
    url = upload_link(api, role="reference", mask="ycbcr", metadata={"order": "42"})
    assert stranger.post("/uploads/link", json={}).status_code == 401
    listed = stranger.get(f"/uploads?{urlsplit(url).query}")  # a link opens one upload, and shows no others
    assert (listed.status_code, listed.json()["code"]) == (401, "unauthorized")
    put = stranger.put(url, content=data, headers={"Content-Disposition": 'attachment; filename="a.png"'})
    assert put.status_code == 200, put.text
    reference = api.client.get(f"/references/{medium_of(api, url)}").json()
    assert reference["sha256"] == hashlib.sha256(data).hexdigest()
    assert (reference["settings"]["mask"], reference["metadata"]) == ("ycbcr", {"order": "42"})
    assert stranger.get(url).json() == put.json()
    assert put.json()["filename"] == reference["filename"] == "a.png"
    # one file, once; who has lost the answer may send it again
    for again in (stranger.put(url, content=data), stranger.put(url, content=iter([data]))):
        assert (again.status_code, again.json()) == (200, put.json())
    for other in (data + b"a", data[:-1] + b"b"):
        assert stranger.put(url, content=other).status_code == 409
    assert len(api.client.get("/references").json()["data"]) == 1
    form = upload_link(api)
    sent = stranger.post(form, files={"file": ("a.mp4", MP4)})
    assert (sent.status_code, sent.json()["filename"]) == (200, "a.mp4")
    assert stranger.post(form, files={"file": ("a.mp4", MP4)}).json() == sent.json()
    assert stranger.post(form, files={"file": ("a.mp4", MP4 + b"b")}).status_code == 409
    assert api.drafts == []
    assert api.client.get(f"/videos/{medium_of(api, form)}").json()["filename"] == "a.mp4"
    # what came by a link is its maker's alone
    assert put.json()["media"] is sent.json()["media"] is stranger.get(form).json()["media"] is None
    assert put.json()["offset_bytes"] == put.json()["size_bytes"] == len(data)
    assert stranger.get(f"/videos/{medium_of(api, form)}").status_code == 401


@pytest.mark.parametrize("pieces", [False, True])
def test_a_link_names_nothing_anew_that_is_there_already(api: Api, stranger: httpx.Client, *, pieces: bool) -> None:
    use_key(api)
    named = {"Content-Disposition": 'attachment; filename="mine.mp4"'}
    mine = api.client.post("/videos?metadata=consent:2026", content=MP4, headers=named).json()
    url = upload_link(api, metadata={"from": "a link"})
    if pieces:
        said = {"Tus-Resumable": "1.0.0", "Upload-Length": str(len(MP4)), "Upload-Metadata": "filename YS5tcDQ="}
        assert stranger.post(url, headers=said).status_code == 201
        offset = {"Tus-Resumable": "1.0.0", "Content-Type": "application/offset+octet-stream", "Upload-Offset": "0"}
        sent = stranger.patch(url, content=MP4, headers=offset)
        assert (sent.status_code, sent.headers.get("pvg-media")) == (204, None)
    else:
        theirs = {"Content-Disposition": 'attachment; filename="theirs.mp4"'}
        assert stranger.put(url, content=MP4, headers=theirs).json()["media"] is None
    assert medium_of(api, url) == mine["id"]
    now = api.client.get(f"/videos/{mine['id']}").json()
    assert (now["filename"], now["metadata"]) == ("mine.mp4", {"consent": "2026"})


def test_a_link_has_a_rate_that_is_not_its_keys(
    api: Api, stranger: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    use_key(api)
    urls = [upload_link(api), api.client.post(f"/results/{make_result(api)}/link").json()["url"]]
    monkeypatch.setattr(rates, "LINK_REQUESTS", 3)
    monkeypatch.setattr(api.services.link_rates, "_now", lambda: 1e6)  # no minute ends meanwhile
    for url in urls:
        assert [stranger.get(url).status_code for _ in range(3)] == [200] * 3
        refused = stranger.get(url)
        assert (refused.status_code, refused.json()["limit"]) == (429, 3)
        assert (refused.json()["unit"], refused.headers["retry-after"]) == ("requests per minute", "20")
    assert api.client.get(urlsplit(urls[0]).path).status_code == 200


def test_a_file_that_is_sent_twice_at_a_time_by_a_link_gets_the_same_answer_twice(
    api: Api, stranger: httpx.Client
) -> None:
    use_key(api)
    first, other = PNG + b"a" * 1000, PNG + b"b" * 1000
    for contents, statuses in (((first, first), [200, 200]), ((first, other), [200, 409])):
        url, begun = upload_link(api, role="reference"), threading.Event()

        def slowly(content: bytes, begun: threading.Event = begun) -> Iterator[bytes]:
            yield content[:500]
            begun.wait(120)
            yield content[500:]

        with ThreadPoolExecutor() as clients:
            sent = [clients.submit(stranger.put, url, content=slowly(content)) for content in contents]
            until(lambda: len(api.drafts) == 2)  # neither is there when the other begins
            begun.set()
            answers = [one.result() for one in sent]
        assert sorted(one.status_code for one in answers) == statuses
        assert all(one.json() == stranger.get(url).json() for one in answers if one.is_success)
        assert api.drafts == []


def test_a_link_keeps_an_upload_to_what_it_was_made_for(api: Api, stranger: httpx.Client) -> None:
    use_key(api)
    most = api.services.settings.max_upload_bytes
    for wanted in ({}, {"max_bytes": most + 1}):
        assert api.client.post("/uploads/link", json=wanted).json()["max_bytes"] == most
    url = upload_link(api, max_bytes=1000)
    assert stranger.put(url, content=MP4 + b"x" * 1000).status_code == 413
    assert stranger.put(url, content=iter([MP4, b"x" * 1000])).status_code == 413
    assert stranger.put(url, content=b"<html>").status_code == 415
    announced = {"Tus-Resumable": "1.0.0", "Upload-Length": "1001"}
    assert stranger.post(url, headers=announced).status_code == 413
    assert stranger.put(url.replace("signature=", "signature=A"), content=MP4).status_code == 403
    other = upload_link(api)
    assert stranger.put(f"{urlsplit(other).path}?{urlsplit(url).query}", content=MP4).status_code == 403
    # the link is good still
    assert stranger.put(url, content=MP4).status_code == 200
    assert api.drafts == []


def test_a_form_by_a_link_holds_no_text_and_is_refused_at_the_head_of_it(api: Api, stranger: httpx.Client) -> None:
    use_key(api)
    at = urlsplit(str(api.client.base_url))
    head = f"POST {upload_link(api)} HTTP/1.1\r\nHost: {at.netloc}\r\nContent-Length: 100000\r\n"
    body = "Content-Type: multipart/form-data; boundary=b\r\n\r\n--b\r\nContent-Disposition: form-data; name=a\r\n\r\n"
    with socket.create_connection((at.hostname, at.port), timeout=30) as sender:
        sender.sendall((head + body).encode())  # nothing of the field has come
        assert sender.recv(4096).startswith(b"HTTP/1.1 400 ")


def test_a_file_in_pieces_by_a_link(api: Api, stranger: httpx.Client) -> None:
    use_key(api)
    url = upload_link(api)
    tus = {"Tus-Resumable": "1.0.0"}
    said = tus | {"Upload-Length": "600000", "Upload-Metadata": "filename YS5tcDQ="}
    for _ in range(2):  # until some of it is there: the answer may have been lost
        begun = stranger.post(url, headers=said)
        assert (begun.status_code, begun.headers["location"]) == (201, url)
        assert api.client.get("/usage").json()["stored_bytes"]["used"] == 600_000
    for other in ({"Upload-Length": "60000"}, {"Upload-Metadata": "filename Yi5tcDQ="}):
        assert stranger.post(url, headers=said | other).status_code == 409
    piece = tus | {"Content-Type": "application/offset+octet-stream"}
    assert stranger.patch(url, content=MP4, headers=piece | {"Upload-Offset": "0"}).status_code == 204
    assert stranger.post(url, headers=said).status_code == 409
    assert stranger.head(url, headers=tus).headers["upload-length"] == "600000"
    rest = b"x" * (600_000 - len(MP4))
    last = stranger.patch(url, content=rest, headers=piece | {"Upload-Offset": str(len(MP4))})
    assert "pvg-media" not in last.headers
    assert api.client.get(f"/videos/{medium_of(api, url)}").status_code == 200


def test_a_link_for_an_upload_expires(api: Api, stranger: httpx.Client) -> None:
    made = api.client.post("/uploads/link", json={}).json()
    now = api.services.database.now()
    late = now - timedelta(seconds=2)
    old = api.services.signer.sign("upload", made["id"], by=keys.NOBODY, seal="", expires_at=late)
    assert stranger.put(f"/uploads/{made['id']}", params=old, content=MP4).status_code == 410


def slowly(api: Api, monkeypatch: pytest.MonkeyPatch) -> Iterator[bytes]:
    """A file whose link expires while it arrives."""
    yield MP4
    until(lambda: api.drafts != [])
    late = utc_now() + timedelta(seconds=3700)
    for database in (api.services.database, api.services.background):
        monkeypatch.setattr(database, "now", lambda: late)
    api.services.reaper.expire()
    yield b"the rest"


def test_a_file_that_is_on_its_way_when_its_link_expires_is_taken(
    api: Api, stranger: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = upload_link(api, expires_in_s=3600)
    sent = stranger.put(url, content=slowly(api, monkeypatch))
    assert sent.status_code == 200, sent.text
    assert api.client.get(f"/videos/{medium_of(api, url)}").json()["size_bytes"] == len(MP4) + 8


def test_a_piece_that_is_on_its_way_when_its_link_expires_is_taken(
    api: Api, stranger: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = upload_link(api, expires_in_s=3600)
    tus = {"Tus-Resumable": "1.0.0"}
    assert stranger.post(url, headers=tus | {"Upload-Length": str(len(MP4) + 8)}).status_code == 201
    piece = tus | {"Content-Type": "application/offset+octet-stream", "Upload-Offset": "0"}
    sent = stranger.patch(url, content=slowly(api, monkeypatch), headers=piece)
    assert sent.status_code == 204, sent.text
    assert api.client.get(f"/videos/{medium_of(api, url)}").json()["size_bytes"] == len(MP4) + 8


def test_a_file_in_pieces_that_is_on_its_way_when_its_link_expires_may_come_whole(
    api: Api, stranger: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, only_announced = (upload_link(api, expires_in_s=3600) for _ in range(2))
    tus = {"Tus-Resumable": "1.0.0"}
    for url in (begun, only_announced):
        assert stranger.post(url, headers=tus | {"Upload-Length": str(len(MP4) + 8)}).status_code == 201
    piece = tus | {"Content-Type": "application/offset+octet-stream"}
    first = stranger.patch(begun, content=MP4, headers=piece | {"Upload-Offset": "0"})
    until_then = parsedate_to_datetime(first.headers["upload-expires"]) - timedelta(seconds=2)
    for database in (api.services.database, api.services.background):
        monkeypatch.setattr(database, "now", lambda: until_then)
    monkeypatch.setattr(api.services.signer, "_now", lambda: until_then)
    api.services.reaper.expire()
    assert stranger.head(only_announced, headers=tus).status_code == 410
    offset = stranger.head(begun, headers=tus).headers["upload-offset"]
    last = stranger.patch(begun, content=b"the rest", headers=piece | {"Upload-Offset": offset})
    assert last.status_code == 204, last.text
    assert stranger.head(begun, headers=tus).headers["upload-offset"] == str(len(MP4) + 8)
    assert api.client.get(f"/videos/{medium_of(api, begun)}").json()["size_bytes"] == len(MP4) + 8


# pages of other sites

PAGE = "https://studio.example"


@pytest.fixture
def pages(tmp_path: Path) -> Iterator[Api]:
    yield from serve(Settings(data_dir=tmp_path / "data", reap_interval_s=3600, allowed_origins=PAGE))


def test_a_page_of_an_allowed_origin_may_upload_in_pieces(pages: Api) -> None:
    for method, wanted in (
        ("POST", "tus-resumable,upload-length,upload-metadata,authorization,idempotency-key"),
        ("PATCH", "tus-resumable,upload-offset,upload-checksum,content-type"),
        *((method, "tus-resumable,authorization") for method in ("HEAD", "DELETE", "GET", "PUT")),
    ):
        asked = {"Access-Control-Request-Method": method, "Access-Control-Request-Headers": wanted}
        answer = pages.client.options("/uploads/upl_0", headers={"Origin": PAGE} | asked)
        assert answer.status_code == 200, answer.text
        assert answer.headers["access-control-allow-origin"] == PAGE
        assert method in answer.headers["access-control-allow-methods"]
        allowed = {name.strip() for name in answer.headers["access-control-allow-headers"].lower().split(",")}
        assert set(wanted.split(",")) <= allowed
    # what the page's script may read of the answers
    headers = {"Origin": PAGE, "Tus-Resumable": "1.0.0"}
    made = pages.client.post("/uploads", headers=headers | {"Upload-Length": "1000"})
    exposed = {name.strip().lower() for name in made.headers["access-control-expose-headers"].split(",")}
    assert exposed >= {"location", "tus-resumable", "upload-offset", "upload-length", "upload-expires", "pvg-media"}
    assert exposed >= {"accept-ranges", "content-range", "content-disposition", "etag", "repr-digest"}
    piece = headers | {"Content-Type": "application/offset+octet-stream", "Upload-Offset": "0"}
    sent = pages.client.patch(made.headers["location"], content=MP4, headers=piece)
    assert (sent.status_code, sent.headers["access-control-allow-origin"]) == (204, PAGE)
    # errors too, or the script does not learn that it should ask for the offset
    again = pages.client.patch(made.headers["location"], content=MP4, headers=piece)
    assert (again.status_code, again.headers["access-control-allow-origin"]) == (409, PAGE)


def test_a_page_of_another_origin_may_not(pages: Api) -> None:
    other = {"Origin": "https://other.example"}
    asked = {"Access-Control-Request-Method": "PATCH", "Access-Control-Request-Headers": "upload-offset"}
    preflight = pages.client.options("/uploads/upl_0", headers=other | asked)
    assert (preflight.status_code, "access-control-allow-origin" in preflight.headers) == (403, False)
    sent = pages.client.post("/uploads", headers=other | {"Tus-Resumable": "1.0.0", "Upload-Length": "1000"})
    assert sent.status_code == 403
