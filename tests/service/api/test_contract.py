"""The schema is the contract: every operation has a name, a type for each answer, examples that fit it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import jsonschema_rs
import pytest

from service.api import problems
from service.api.advice import ADVICE
from service.errors import PROBLEM_JSON, PROBLEMS
from service.settings import Settings
from tests.service.api.test_media import transfer, upload
from tests.service.fixtures import MP4, Api, make_ready, make_results, serve

Operation = tuple[str, str, dict[str, Any]]
#: of the models of `/limits` and `/usage`
LIMITS = ("Limits", "RequestsUsed")


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    """One service for all of these tests."""
    settings = Settings(data_dir=tmp_path_factory.mktemp("service") / "data", reap_interval_s=3600)
    yield from serve(settings.model_copy(update={"max_upload_bytes": 1000, "max_looks": 2}))


@pytest.fixture(scope="module")
def schema(api: Api) -> dict[str, Any]:
    described: dict[str, Any] = api.client.get("/openapi.json").json()
    return described


def operations(schema: dict[str, Any]) -> Iterator[Operation]:
    for path, methods in schema["paths"].items():
        for method, operation in methods.items():
            yield path, method, operation


def contents(operation: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """(where, media type, content) of an operation's bodies."""
    for kind, content in operation.get("requestBody", {}).get("content", {}).items():
        yield "request", kind, content
    for status, answer in operation["responses"].items():
        for kind, content in answer.get("content", {}).items():
            yield status, kind, content


def fits(schema: dict[str, Any], wanted: dict[str, Any], value: Any) -> None:
    jsonschema_rs.validator_for({**wanted, "components": schema["components"]}, validate_formats=True).validate(value)


def test_operation_ids_are_verbs_and_each_is_there_once(schema: dict[str, Any]) -> None:
    ids = [operation["operationId"] for _, _, operation in operations(schema)]
    assert len(set(ids)) == len(ids)
    assert {"create_video", "list_videos", "get_video", "delete_video", "create_transfer", "get_job"} < set(ids)
    verbs = {"create", "list", "get", "delete", "cancel", "replay", "update", "watch", "append", "send", "rotate"}
    assert {one.partition("_")[0] for one in ids} <= verbs
    assert all(re.fullmatch(r"[a-z]+(_[a-z]+)+", one) for one in ids)


def test_every_operation_says_what_it_is_and_takes_one_type_of_body(schema: dict[str, Any]) -> None:
    tags = {tag["name"] for tag in schema["tags"]}
    for path, method, operation in operations(schema):
        assert operation["summary"], path
        assert operation["description"], path
        assert set(operation["tags"]) <= tags, path
        assert len(operation.get("requestBody", {}).get("content", {"-": 0})) == 1, (method, path)


def test_all_that_a_medium_fails_with_is_told_with_422(schema: dict[str, Any]) -> None:
    answer = schema["paths"]["/v1/transfer"]["post"]["responses"]["422"]
    kinds = answer["content"][PROBLEM_JSON]["examples"]
    assert kinds.keys() >= {"no-face", "too-long", "too-large", "unavailable", "insufficient-storage", "internal-error"}
    assert {kind["value"]["status"] for kind in kinds.values()} == {422}


def test_an_operation_tells_of_the_problems_alone_that_it_can_answer_with(schema: dict[str, Any]) -> None:
    def kinds(operation: dict[str, Any], status: str) -> set[str]:
        return set(operation["responses"].get(status, {}).get("content", {}).get(PROBLEM_JSON, {}).get("examples", {}))

    by_id = {operation["operationId"]: operation for _, _, operation in operations(schema)}
    assert kinds(by_id["list_videos"], "422") == {"validation-failed"}
    assert kinds(by_id["delete_video"], "409") == {"conflict"}
    assert kinds(by_id["create_video"], "409") == {"conflict", "idempotency-key-in-use"}
    assert "fetch-failed" in kinds(by_id["create_video"], "422")
    assert "fetch-failed" not in kinds(by_id["create_transfer"], "422")
    media = {"create_transfer", "create_transfer_from_form", "create_swap", "create_preview"}
    media |= {f"get_{role}_{name}" for role in ("video", "reference") for name in ("frame", "poster", "face_thumbnail")}
    assert {name for name, one in by_id.items() if "no-face" in kinds(one, "422")} == media
    named = {name for name, one in by_id.items() if "idempotency-key-reused" in kinds(one, "422")}
    assert named == {
        name for name, one in by_id.items() if "idempotency-key" in {each["name"] for each in one.get("parameters", [])}
    }
    posts = {operation["operationId"] for _, method, operation in operations(schema) if method == "post"}
    assert posts - named == {"send_upload_as_form"}  # what is sent there again is known by its bytes or its offset


def test_every_answer_and_parameter_says_what_it_is(schema: dict[str, Any]) -> None:
    for path, method, operation in operations(schema):
        told = {status: answer["description"] for status, answer in operation["responses"].items()}
        assert all(told.values()), (method, path, told)
        assert "Successful Response" not in told.values(), (method, path)
        silent = [one["name"] for one in operation.get("parameters", []) if not one.get("description")]
        assert silent == [], (method, path)


def test_fields_of_pictures_and_of_tus_are_declared_where_they_are_sent(schema: dict[str, Any]) -> None:
    having = {
        operation["operationId"]
        for _, _, operation in operations(schema)
        for answer in operation["responses"].values()
        if "Pvg-Frame" in answer.get("headers", {})
    }
    small = {f"get_{role}_{name}" for role in ("video", "reference") for name in ("poster", "face_thumbnail")}
    assert having == {"create_preview", "get_video_frame", "get_reference_frame", *small}
    as_form = schema["paths"]["/v1/uploads/{upload_id}"]["post"]
    assert "X-HTTP-Method-Override" in {one["name"] for one in as_form["parameters"]}
    assert {"Location", "Upload-Offset", "Tus-Resumable"} <= as_form["responses"]["201"]["headers"].keys()


def test_what_writes_may_find_the_disk_full(schema: dict[str, Any]) -> None:
    pictures = ("image/jpeg", "image/png")
    for path, method, operation in operations(schema):
        content = operation["responses"].get("200", {}).get("content", {})
        is_made = any(kind in content for kind in pictures) and "206" not in operation["responses"]
        if method not in {"get", "options"} or is_made:
            assert "507" in operation["responses"], (method, path)


def test_every_json_body_has_examples_that_fit_it(schema: dict[str, Any]) -> None:
    for path, method, operation in operations(schema):
        for where, kind, content in contents(operation):
            if kind not in {"application/json", PROBLEM_JSON}:
                continue
            assert content.get("examples"), f"{method} {path} has no example of {where}: see service/api/examples.py"
            for example in content["examples"].values():
                fits(schema, content["schema"], example["value"])


def test_no_answer_is_untyped(schema: dict[str, Any]) -> None:
    for path, method, operation in operations(schema):
        for where, kind, content in contents(operation):
            assert content.get("schema"), (method, path, where, kind)
    for name, model in schema["components"]["schemas"].items():
        for field, described in model.get("properties", {}).items():
            loose = described.get("type") == "object" and described.get("additionalProperties") is True
            assert not loose, f"{name}.{field} may be anything"


def test_bounds_of_numbers_are_words_of_json_schema(schema: dict[str, Any]) -> None:
    words = re.findall(r'"(ge|gt|le|lt|multiple_of)": ', json.dumps(schema))
    assert not words
    link = schema["components"]["schemas"]["ResultLinkRequest"]["properties"]["expires_in_s"]
    assert (link["minimum"], link["maximum"]) == (1, 7 * 86_400)


def test_answers_are_as_the_schema_says(api: Api, schema: dict[str, Any]) -> None:
    video = upload(api, "/videos")["id"]
    make_ready(api.services, video)
    job = transfer(api, video, video)["id"]
    make_results(api.services, job, [b"one"], parts=[("look.cube", 1, b"cube")])
    waiting = api.client.post("/v1/videos", content=MP4 + b"2").json()["job"]
    assert api.client.post("/v1/uploads/link", json={"metadata": {"order": "42"}}).status_code == 201
    for path, model in (
        (f"/v1/videos/{video}", "MediaBody"),
        ("/v1/videos", "MediaPage"),
        (f"/v1/jobs/{job}", "JobBody"),
        (f"/v1/jobs/{waiting}", "JobBody"),
        ("/v1/jobs", "JobPage"),
        ("/v1/uploads", "UploadPage"),
        ("/v1/limits", "LimitsBody"),
        ("/v1/usage", "UsageBody"),
        ("/readyz", "Readiness"),
    ):
        fits(schema, {"$ref": f"#/components/schemas/{model}"}, api.client.get(path).json())


def test_a_problem_leads_to_what_is_said_of_it(api: Api) -> None:
    page = api.client.get("/docs/problems")
    assert "`" not in page.text
    assert "<code>Retry-After</code>" in page.text
    assert page.headers["content-type"].startswith("text/html")
    assert PROBLEMS.keys() == ADVICE.keys()
    anchors = re.findall(r'id="([a-z-]+)"', page.text)
    assert sorted(anchors) == sorted(PROBLEMS)
    problem = api.client.get("/v1/videos/vid_1").json()
    assert (problem["type"], problem["code"]) == ("/docs/problems#not-found", "not-found")
    assert problem["type"].partition("#")[0] == page.request.url.path


def test_behind_a_proxy_a_problem_has_its_path(settings: Settings) -> None:
    for proxied in serve(settings.model_copy(update={"root_path": "/faces"})):
        assert proxied.client.get("/v1/videos/vid_1").json()["type"] == "/faces/docs/problems#not-found"
        assert proxied.client.get("/openapi.json").json()["servers"] == [{"url": "/faces"}]


@pytest.mark.parametrize(
    ("path", "allowed"),
    [
        ("/v1/videos", "GET, HEAD, POST"),
        ("/v1/videos/vid_1", "GET, HEAD, DELETE"),
        ("/v1/results/res_1", "GET, HEAD, DELETE"),
        ("/v1/videos/form", "POST"),
        ("/transfer", "POST"),
        ("/livez", "GET, HEAD"),
    ],
)
def test_a_method_that_an_address_does_not_take_is_answered_with_those_it_does(
    api: Api, path: str, allowed: str
) -> None:
    answer = api.client.request("PATCH", path)
    assert (answer.status_code, answer.json()["code"]) == (405, "method-not-allowed")
    assert answer.headers["allow"] == allowed


def test_the_methods_of_an_address_are_told_without_the_schema(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(api.app, "openapi", Mock(side_effect=AssertionError))
    scope = {"type": "http", "method": "PATCH", "headers": []}
    assert problems.allowed(api.app, {**scope, "path": "/v1/videos/form"}) == ["POST"]
    assert problems.allowed(api.app, {**scope, "path": "/videos/vid_1"}) == ["GET", "HEAD", "DELETE"]


def test_what_is_too_much_says_how_much_is_allowed(api: Api) -> None:
    large = api.client.post("/v1/videos", content=MP4 + bytes(2000)).json()
    assert (large["code"], large["limit"], large["unit"]) == ("too-large", 1000, "bytes")
    video = api.client.post("/v1/videos", content=MP4 + b"3").json()["id"]
    many = api.client.post("/v1/transfer", json={"video": video, "looks": [{"reference": video}] * 3})
    assert many.status_code == 422
    assert (many.json()["limit"], many.json()["unit"]) == (2, "looks")
    limits = api.client.get("/v1/limits").json()
    assert limits["upload"]["bytes"] == 1000
    assert (limits["transport"]["uploads"], limits["transport"]["fetches"]) == (1000, 8)


def test_the_form_of_a_transfer_has_the_options_of_its_json(schema: dict[str, Any]) -> None:
    form = schema["paths"]["/v1/transfer/form"]["post"]["requestBody"]["content"]["multipart/form-data"]["schema"]
    models = schema["components"]["schemas"]
    wanted = {*models["LookRequest"]["properties"], *models["OutputRequest"]["properties"]}
    assert form["properties"].keys() == wanted | models["TransferRequest"]["properties"].keys() - {"looks", "output"}


def test_fields_and_parameters_are_in_the_documentation(schema: dict[str, Any]) -> None:
    """But for those of limits, whose names in the schema say it all."""
    told = (Path(__file__).resolve().parents[3] / "docs" / "api.md").read_text()
    models = {name: one for name, one in schema["components"]["schemas"].items() if not name.endswith(LIMITS)}
    named = {(where, name) for where, one in models.items() for name in one.get("properties", ())}
    for _, _, operation in operations(schema):
        query = (one["name"] for one in operation.get("parameters", ()) if one["in"] == "query")
        named |= {(operation["operationId"], name) for name in query}
    missing = [one for one in sorted(named) if not re.search(rf"(?<![\w-]){re.escape(one[1])}(?!\w)", told)]
    assert missing == [], "each belongs into docs/api.md"


def test_a_number_without_a_fraction_is_an_integer(api: Api) -> None:
    video = api.client.post("/v1/videos", content=MP4 + b"4").json()["id"]
    body = {"video": video, "looks": [{"reference": video, "seed": 1.0, "faces": [0.0]}], "output": {"crf": 20.0}}
    answer = api.client.post("/v1/transfer", json=body)
    assert answer.status_code == 202, answer.text
    assert answer.json()["looks"][0]["options"]["faces"] == [0]
    body["looks"][0]["seed"] = 1.5
    assert api.client.post("/v1/transfer", json=body).json()["errors"][0]["pointer"] == "/looks/0/seed"


def test_what_an_answer_depends_on_is_in_the_schema(api: Api, schema: dict[str, Any]) -> None:
    for path, method, operation in operations(schema):
        names = {one["name"].lower() for one in operation.get("parameters", [])}
        assert ("304" in operation["responses"]) == ("if-none-match" in names), (method, path)
    job = schema["paths"]["/v1/jobs/{job_id}"]["get"]
    assert {"wait", "Prefer"} < {one["name"] for one in job["parameters"]}
    job_id = upload(api, "/videos", b"preferred")["job"]
    assert api.client.get(f"/jobs/{job_id}", headers={"Prefer": "wait=0"}).headers["preference-applied"] == "wait=0"


@pytest.mark.parametrize("path", ["/videos", "/references", "/videos/form", "/references/url"])
def test_a_setting_that_there_is_not_is_refused_wherever_it_stands(api: Api, path: str) -> None:
    sent: dict[str, Any] = {"content": MP4}
    if path.endswith("/form"):
        sent = {"files": {"file": ("clip.mp4", MP4)}}
    if path.endswith("/url"):
        sent = {"json": {"url": "https://media.example/clip.mp4"}}
    answer = api.client.post(f"{path}?maks=ycbcr", **sent)
    assert (answer.status_code, answer.json()["errors"][0]["pointer"]) == (422, "/query/maks")
    assert not list((api.services.settings.spool_folder).iterdir())
