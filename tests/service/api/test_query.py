"""A parameter of a query that an operation does not know, or that is given twice, is refused and named."""

from __future__ import annotations

import pytest

from tests.service.api.test_media import transfer, upload
from tests.service.api.test_problems import check
from tests.service.fixtures import MP4, Api, make_ready, make_results

NO_ID = "0" * 32


@pytest.mark.parametrize(
    ("path", "name", "known"),
    [
        ("/v1/jobs?stat=queued", "stat", "known are: cursor, id, kind, limit, metadata, reference, state, video"),
        ("/jobs?limit=2&stat=queued", "stat", "known are: cursor, id, kind, limit, metadata, reference, state, video"),
        ("/videos?sort=name", "sort", "cursor, limit, metadata, state"),
        (f"/videos/vid_{NO_ID}/frames/3?layre=matte", "layre", "layer"),
        (f"/references/ref_{NO_ID}/poster?size=2", "size", "known are: none"),
        ("/limits?of=me", "of", "known are: none"),
        (f"/results/res_{NO_ID}?person=2", "person", "by, expires, signature"),
        (f"/uploads/upl_{NO_ID}?sig=x", "sig", "by, expires, signature"),
    ],
)
def test_an_unknown_parameter_is_named(api: Api, path: str, name: str, known: str) -> None:
    for method in ("GET", "HEAD") if "uploads" not in path else ("GET", "PUT", "DELETE"):
        answer = api.client.request(method, path)
        assert answer.status_code == 422
        if method != "HEAD":
            body = check(answer, 422)
            assert body["code"] == "validation-failed"
            assert body["errors"][0]["pointer"] == f"/query/{name}"
            assert known in body["detail"]


def test_those_of_calls_that_change_something_too(api: Api) -> None:
    video = upload(api, "/videos")["id"]
    assert api.client.delete(f"/videos/{video}?cancel=true").status_code == 422
    assert api.client.get(f"/videos/{video}").status_code == 200
    assert api.client.post("/transfer?force=true", json={}).json()["errors"][0]["pointer"] == "/query/force"
    form = api.client.post("/videos/form?metadata=a:b", files={"file": ("clip.mp4", MP4)})
    assert form.json()["errors"][0]["pointer"] == "/query/metadata"


def test_what_is_wrong_with_a_parameter_is_told_of_the_query(api: Api) -> None:
    twice = "metadata=a:1&metadata=a:2"
    many = ",".join(["job_1"] * 201)
    for path in (f"/jobs?{twice}", f"/videos?{twice}", "/jobs?limit=0", f"/jobs?id={many}"):
        name = path.partition("?")[2].partition("=")[0]
        assert api.client.get(path).json()["errors"][0]["pointer"] == f"/query/{name}"
    upload = api.client.post(f"/videos?{twice}", content=MP4)
    assert upload.json()["errors"][0]["pointer"] == "/query/metadata"
    form = api.client.post("/videos/form", files={"file": ("a.mp4", MP4)}, data={"metadata": ["a:1", "a:2"]})
    assert form.json()["errors"][0]["pointer"] == "/metadata"


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("POST", "/videos?webhook=https://a.example/&webhook=https://b.example/"),
        ("POST", "/references?mask=ycbcr&mask=landmarks"),
        ("GET", f"/jobs?id=job_{NO_ID}&id=job_{NO_ID}"),
        ("GET", f"/v1/jobs?video=vid_{NO_ID}&video=vid_{NO_ID}"),
        ("GET", "/videos?limit=2&limit=2"),
        ("DELETE", f"/videos/vid_{NO_ID}?cancel_jobs=true&cancel_jobs=false"),
        ("GET", f"/results/res_{NO_ID}/matte?person=1&person=2"),
        ("GET", f"/results/res_{NO_ID}?expires=1&expires=2&signature=x&signature=y"),
    ],
)
def test_a_parameter_that_is_no_list_is_given_once(api: Api, method: str, path: str) -> None:
    answer = api.client.request(method, path, content=MP4 if method == "POST" else b"")
    name = path.partition("?")[2].partition("=")[0]
    body = check(answer, 422)
    assert body["errors"][0] == {"pointer": f"/query/{name}", "detail": "it is given more than once"}
    assert api.client.get("/videos").json()["data"] == []


def test_lists_are_given_again(api: Api) -> None:
    lists = "state=queued&state=running&kind=swap&kind=transfer&metadata=a:1&metadata=b:2"
    assert api.client.get(f"/jobs?{lists}").status_code == 200
    assert api.client.get("/videos?state=ready&state=failed&metadata=a:1&metadata=b:2").status_code == 200
    assert api.client.get("/webhooks?state=failed&state=pending").status_code == 200
    made = api.client.post("/videos?metadata=a:1&metadata=b:2", content=MP4)
    assert made.json()["metadata"] == {"a": "1", "b": "2"}


def test_links_and_parts_open_as_they_were_made(api: Api) -> None:
    video, reference = upload(api, "/videos")["id"], upload(api, "/references")["id"]
    for one in (video, reference):
        make_ready(api.services, one)
    job = transfer(api, video, reference)
    parts = [("matte", 1, b"one"), ("matte", 2, b"two")]
    (result,) = make_results(api.services, job["id"], [b"clip"], parts=parts)  # type: ignore[arg-type]
    link = api.client.post(f"/results/{result}/link", json={"part": "matte", "person": 2}).json()["url"]
    assert api.client.get(link).content == b"two"
    assert api.client.get(f"{link}&utm_source=mail").content == b"two"  # links are handed on, and added to
    upload_link = api.client.post("/uploads/link", json={}).json()["url"]
    assert api.client.put(upload_link, content=MP4 + b"by link").status_code == 200


def test_a_signature_says_nothing_where_no_link_leads(api: Api) -> None:
    for path in ("/jobs?signature=x&stat=queued", "/v1/videos?stat=ready&signature=x", "/limits?signature=x"):
        errors = check(api.client.get(path), 422)["errors"]
        assert "/query/signature" in {one["pointer"] for one in errors}
        assert len(errors) == path.count("=")
    assert api.client.post("/transfer?signature=x", json={}).json()["errors"][0]["pointer"] == "/query/signature"


def test_what_watches_the_service_may_ask_as_it_likes(api: Api) -> None:
    for path in ("/livez?probe=7", "/v1/readyz?probe=7", "/metrics?collect[]=jobs", "/?from=mail", "/docs?x=1"):
        assert api.client.get(path).status_code == 200, path
