from __future__ import annotations

import gzip
import re
import time
import timeit
from typing import Any

import pytest
from pydantic import ValidationError
from sqlalchemy import Connection, event

from service.api import problems
from service.api.schemas import TransferRequest
from service.storage import Storage
from tests.service.fixtures import MP4, PNG, Api


def check(answer: Any, status: int) -> dict[str, Any]:
    """Every error has this shape."""
    assert answer.status_code == status
    assert answer.headers["content-type"] == "application/problem+json"
    body: dict[str, Any] = answer.json()
    assert {"type", "title", "status", "detail", "instance", "request_id"} <= body.keys()
    assert body["status"] == status
    assert body["instance"] == answer.request.url.path
    assert body["request_id"] == answer.headers["x-request-id"]
    return body


def test_every_error_is_a_problem(api: Api) -> None:
    client = api.client
    check(client.get("/nowhere"), 404)
    check(client.put("/videos"), 405)
    check(client.get("/videos?limit=0"), 422)
    check(client.get("/videos/x"), 404)
    check(client.post("/videos", content=b"x"), 415)
    check(client.post("/transfer", content=b"{", headers={"content-type": "application/json"}), 400)


def test_what_there_is_instead_is_said(api: Api) -> None:
    client, text = api.client, {"content-type": "text/plain"}
    details = [
        (client.get("/nowhere"), "there is no such address; /docs has those there are"),
        (client.put("/v1/videos"), "PUT is not for this address, which takes GET, HEAD, POST"),
        (client.post("/swap", content=b"{}"), "send this as application/json; it has no type"),
        (
            client.post("/transfer", content=b"{}", headers=text),
            "send this as application/json or multipart/form-data; it came as text/plain",
        ),
        (client.post("/transfer/form", json={}), "send this as multipart/form-data; it came as application/json"),
        (
            client.post("/videos/url", data={"url": "x"}),
            "send this as application/json; it came as application/x-www-form-urlencoded",
        ),
        (client.post("/videos/form", json={}), "send this as multipart/form-data; it came as application/json"),
    ]
    for answer, detail in details:
        assert check(answer, answer.status_code)["detail"] == detail


def test_what_is_wrong_is_said_in_words_and_not_in_patterns(api: Api) -> None:
    client = api.client
    wanted = {"video": "clip.mp4", "looks": [{"reference": "ref_x", "colour": 1}], "metadata": {"a b": "c"}}
    errors = {one["pointer"]: one["detail"] for one in client.post("/transfer", json=wanted).json()["errors"]}
    no_id = "this is not the id of a video or a reference"
    assert errors == {
        "/video": no_id,
        "/looks/0/reference": no_id,
        "/looks/0/colour": "there is no such field here",
        "/metadata/a b": "a name has up to 40 letters, digits, `_`, `.`, `-`",
    }
    lists = {"videos": "vid", "references": "ref", "jobs": "job", "webhooks": "msg", "uploads": "upl"}
    for listed in lists:
        for wrong in ["x", *(f"{prefix}_{0:032x}" for other, prefix in lists.items() if other != listed)]:
            detail = check(client.get(f"/{listed}?cursor={wrong}"), 422)["detail"]
            assert detail == "/query/cursor: this is not the `next_cursor` of a page"
    detail = client.get("/videos?metadata=x").json()["detail"]
    assert "this is not name:value" in detail
    assert "pattern" not in detail


def test_a_file_where_a_text_belongs_and_a_text_where_a_file_does_are_told(api: Api) -> None:
    client, picture = api.client, {"reference": ("a.png", PNG)}
    without_file = [
        (client.post("/videos", files={"mask": (None, "ycbcr"), "file": (None, "clip.mp4")}), "@ stands before"),
        (client.post("/transfer", files={"video": ("a.mp4", MP4)} | picture), "upload the file to /videos first"),
        (client.post("/transfer", files={"video": (None, "vid_x"), "strength": ("a", b"1")} | picture), "takes a text"),
        (client.post("/transfer", files={"video": (None, f"vid_{0:032x}"), "reference": (None, "a.jpg")}), "@ stands"),
    ]
    for answer, detail in without_file:
        assert detail in check(answer, answer.status_code)["detail"]


def test_a_request_id_is_kept_when_it_is_harmless(api: Api) -> None:
    assert api.client.get("/livez", headers={"x-request-id": "abc-1.2_3"}).headers["x-request-id"] == "abc-1.2_3"
    for bad in ("a b", "x" * 200, "<script>"):
        made = api.client.get("/livez", headers={"x-request-id": bad}).headers["x-request-id"]
        assert re.fullmatch(r"req_[0-9a-f]{32}", made)


def test_internals_stay_in_the_log(api: Api, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("secret path /srv/pvg")

    monkeypatch.setattr(Storage, "put", fail)
    body = check(api.client.post("/videos", content=PNG), 500)
    assert body["code"] == "internal-error"
    assert "secret" not in str(body)
    (record,) = [record for record in caplog.records if record.msg == "unhandled error"]
    assert "secret path" in str(vars(record))
    assert api.blobs == []
    assert api.drafts == []


def test_a_full_disk_is_507_and_leaves_nothing(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Storage, "put", full)
    assert check(api.client.post("/videos", content=PNG), 507)["code"] == "insufficient-storage"
    assert api.client.get("/videos").json()["data"] == []
    assert api.drafts == []
    monkeypatch.undo()
    assert api.client.post("/videos", content=PNG).status_code == 202


@pytest.mark.embedded
def test_a_database_without_room_is_507(api: Api) -> None:
    def no_more_pages(connection: Connection) -> None:
        connection.exec_driver_sql("PRAGMA max_page_count = 1")  # SQLite takes the present size for it

    engine = api.services.database._engine
    event.listen(engine, "begin", no_more_pages)
    answers = [api.client.post("/videos", content=PNG + bytes([k])) for k in range(40)]
    assert check(answers[-1], 507)["code"] == "insufficient-storage"
    assert {answer.status_code for answer in answers} <= {202, 507}
    assert api.client.get("/videos").status_code == 200
    assert len(api.blobs) == sum(answer.status_code == 202 for answer in answers)
    assert api.drafts == []


def test_the_schema_resolves_and_lists_every_endpoint(api: Api) -> None:
    schema = api.client.get("/openapi.json").json()
    assert {
        "/v1/videos",
        "/v1/videos/form",
        "/v1/videos/url",
        "/v1/videos/{video_id}",
        "/v1/videos/{video_id}/file",
        "/v1/videos/{video_id}/poster",
        "/v1/videos/{video_id}/frames/{number}",
        "/v1/videos/{video_id}/faces/{face}/thumbnail",
        "/v1/references",
        "/v1/references/form",
        "/v1/references/url",
        "/v1/references/{reference_id}",
        "/v1/references/{reference_id}/file",
        "/v1/references/{reference_id}/poster",
        "/v1/references/{reference_id}/frames/{number}",
        "/v1/references/{reference_id}/faces/{face}/thumbnail",
        "/v1/uploads",
        "/v1/uploads/link",
        "/v1/uploads/{upload_id}",
        "/v1/transfer",
        "/v1/transfer/form",
        "/v1/swap",
        "/v1/preview",
        "/v1/jobs",
        "/v1/jobs/{job_id}",
        "/v1/jobs/{job_id}/cancel",
        "/v1/jobs/{job_id}/events",
        "/v1/webhooks",
        "/v1/webhooks/secret",
        "/v1/webhooks/secret/rotate",
        "/v1/webhooks/{webhook_id}",
        "/v1/webhooks/{webhook_id}/replay",
        "/v1/results/{result_id}",
        "/v1/results/{result_id}/look.cube",
        "/v1/results/{result_id}/matte",
        "/v1/results/{result_id}/link",
        "/livez",
        "/readyz",
        "/metrics",
        "/v1/limits",
        "/v1/usage",
    } == schema["paths"].keys()

    def references(node: object) -> list[str]:
        if isinstance(node, dict):
            here = [node["$ref"]] if isinstance(node.get("$ref"), str) else []
            return here + [ref for value in node.values() for ref in references(value)]
        return [ref for value in node for ref in references(value)] if isinstance(node, list) else []

    found = references(schema)
    assert "#/components/schemas/TransferRequest" in found
    for ref in found:
        _, _, kind, name = ref.split("/")
        assert name in schema["components"][kind]
    assert api.client.get("/docs").status_code == 200


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("POST", "/videos"),
        ("POST", "/videos/url"),
        ("POST", "/references/form"),
        ("POST", "/transfer"),
        ("POST", "/transfer/form"),
        ("POST", "/swap"),
        ("POST", "/preview"),
        ("POST", "/uploads/link"),
        ("POST", f"/results/res_{'0' * 32}/link"),
        ("PUT", "upload"),
        ("PATCH", "upload"),
    ],
)
def test_a_compressed_body_is_415_and_says_what_is_taken(api: Api, method: str, path: str) -> None:
    sent: dict[str, Any] = {"content": gzip.compress(b"{}"), "headers": {"content-type": "application/json"}}
    if path.endswith("form"):
        sent["headers"] = {"content-type": "multipart/form-data; boundary=x"}
    if path == "upload":
        path = api.client.post("/uploads/link", json={}).json()["url"]
        sent["headers"] = {"content-type": "application/octet-stream"}
    if method == "PATCH":
        announced = api.client.post(path, headers={"tus-resumable": "1.0.0", "upload-length": "100"})
        assert announced.status_code == 201
        sent["headers"] = {"content-type": "application/offset+octet-stream", "tus-resumable": "1.0.0"}
        sent["headers"] |= {"upload-offset": "0"}
    for coding in ("gzip", "identity, BR"):
        sent["headers"] |= {"content-encoding": coding}
        answer = api.client.request(method, path, **sent)
        body = check(answer, 415)
        assert answer.headers["accept-encoding"] == "identity"
        assert f"Content-Encoding is {coding.split()[-1].lower()}" in body["detail"]
    assert (api.blobs, api.drafts) == ([], [])


def test_a_body_that_says_it_is_as_it_is_is_taken(api: Api) -> None:
    as_it_is = {"content-encoding": "Identity"}
    assert api.client.post("/videos", content=PNG, headers=as_it_is).status_code == 202
    assert api.client.post("/uploads/link", json={}, headers=as_it_is).status_code == 201
    assert "accept-encoding" not in api.client.post("/videos", content=b"no film").headers


def test_a_long_name_of_a_field_is_looked_at_once() -> None:
    name = "function-" + "a" * 20_000 + "\n"
    began = time.thread_time()
    assert problems._place((name,)) == (name,)
    assert time.thread_time() - began < 1


def test_of_many_errors_the_first_are_listed(api: Api) -> None:
    body = {"video": "vid_" + "0" * 32, "looks": [0] * 1000}
    problem = check(api.client.post("/transfer", json=body), 422)
    assert problem["detail"].endswith("; errors has the first 100 of 1000")
    assert [error["pointer"] for error in problem["errors"]] == [f"/looks/{i}" for i in range(100)]
    unknown = check(api.client.post("/preview", json={f"k{i}": 0 for i in range(2000)}), 422)
    assert len(unknown["errors"]) == 100
    assert len(check(api.client.get("/jobs?" + "&".join(["state=x"] * 1500)), 422)["errors"]) == 100
    assert len(check(api.client.get("/jobs?" + "&".join(f"x{i}" for i in range(1500))), 422)["errors"]) == 100


@pytest.mark.parametrize("number", [b"NaN", b"Infinity", b"-Infinity"])
def test_what_json_has_no_number_for_is_no_json(api: Api, number: bytes) -> None:
    """RFC 8259, 6: wherever it stands, and in every body alike."""
    json_type = {"content-type": "application/json"}
    result = f"/results/res_{'0' * 32}/link"
    for path in ("/transfer", "/swap", "/preview", "/videos", "/references", "/videos/url", "/uploads/link", result):
        for body in (b'{"expires_in_s": %s}', b'{"looks": [{"strength": %s}]}', b"%s"):
            refused = api.client.post(path, content=body % number, headers=json_type)
            assert (refused.status_code, refused.json()["code"]) == (400, "malformed"), (path, refused.text)
            assert refused.json()["detail"] == "the body is not valid JSON"
    named = api.client.post("/uploads/link", content=b'{"metadata": {"a": "%s"}}' % number, headers=json_type)
    assert named.status_code == 201  # a text may be so


def test_of_a_body_that_is_all_wrong_nothing_is_listed(api: Api) -> None:
    body = {"video": "vid_" + "0" * 32, "looks": [0]} | {f"k{i}": 0 for i in range(50_000)}
    problem = check(api.client.post("/transfer", json=body), 422)
    assert problem["detail"] == "the body is wrong in 50001 places"
    assert "errors" not in problem
    form = {"video": "vid_" + "0" * 32, "reference": ["x"] * 60, "protect": ",".join("x" * 60), "faces": "y," * 60}
    fields = [
        (name, (None, text)) for name, given in form.items() for text in ([given] if isinstance(given, str) else given)
    ]
    assert "errors" not in check(api.client.post("/transfer/form", files=fields), 422)


def test_errors_take_a_time_that_grows_with_their_number() -> None:
    with pytest.raises(ValidationError) as refused:
        TransferRequest.model_validate({"video": "vid_" + "0" * 32} | {f"k{i}": 0 for i in range(4900)})
    assert refused.value.error_count() == 4901
    # the best of five: a collection of the whole process's garbage may fall into one
    times = timeit.repeat(lambda: problems.invalid(refused.value), timer=time.thread_time, repeat=5, number=1)
    assert min(times) < 1


def test_of_a_union_only_what_is_wrong_inside_is_said() -> None:
    with pytest.raises(ValidationError) as refused:
        TransferRequest.model_validate(
            {"video": "vid_" + "0" * 32, "looks": [{"reference": "ref_" + "0" * 32, "faces": [0, -1], "match": "x"}]}
        )
    assert [error["pointer"] for error in problems.invalid(refused.value).errors] == [
        "/looks/0/match",
        "/looks/0/faces/1",
    ]


def test_words_are_given_again_a_few_times_only(api: Api) -> None:
    look = {"reference": "ref_" + "0" * 32, "protect": ["eyes"] * 65}
    problem = check(api.client.post("/transfer", json={"video": "vid_" + "0" * 32, "looks": [look]}), 422)
    assert [error["pointer"] for error in problem["errors"]] == ["/looks/0/protect"]
