"""/metrics, and the rules and the dashboard that read it."""

from __future__ import annotations

import json
import re
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families
from pydantic import SecretStr
from sqlalchemy.exc import OperationalError
from sqlalchemy.orm import Session

from service.catalog import Database, keys, leases, sweep, workers
from service.settings import Settings
from tests.service.api.test_media import PROBLEM, transfer, upload
from tests.service.fixtures import Api, claim, make_ready, make_results, serve
from tests.waiting import until

OPS = Path(__file__).parents[3] / "docs" / "operations"
Figures = dict[tuple[str, frozenset[tuple[str, str]]], float]


def figures(api: Api) -> Figures:
    answer = api.client.get("/metrics")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/plain")
    return {
        (sample.name, frozenset(sample.labels.items())): sample.value
        for family in text_string_to_metric_families(answer.text)
        for sample in family.samples
    }


def figure(found: Figures, name: str, **labels: str) -> float:
    return found[name, frozenset(labels.items())]


def test_requests_are_counted_by_the_template_of_their_route(api: Api) -> None:
    for path in ("/v1/videos/vid_1", "/videos/vid_2", "/v1/videos/vid_3"):
        api.client.get(path)
    api.client.get("/nowhere")
    api.client.request("BREW", "/nowhere")
    api.client.put("/v1/videos/vid_1")
    # a request is counted after its answer; the one in progress asks
    found = until(lambda: now if figure(now := figures(api), "pvg_http_requests_in_progress") == 1 else None)
    labels = {"route": "/v1/videos/{video_id}", "method": "GET"}
    assert figure(found, "pvg_http_requests_total", **labels, status="404") == 3
    assert figure(found, "pvg_http_request_duration_seconds_count", **labels) == 3
    assert figure(found, "pvg_http_requests_total", route="other", method="OTHER", status="404") == 1
    values = {value for _, labels in found for _, value in labels}
    assert not [value for value in values if re.search(r"(vid|ref|job|res|key)_", value)]


def test_jobs_are_counted_when_they_are_asked_for(api: Api) -> None:
    video, reference = upload(api, "/videos"), upload(api, "/references")
    found = figures(api)
    assert figure(found, "pvg_jobs", queue="vectorize", state="queued") == 2
    assert figure(found, "pvg_stored_bytes", what="source") == video["size_bytes"] + reference["size_bytes"]
    make_ready(api.services, video["id"])
    transfer(api, video["id"], reference["id"])
    with api.services.background.write() as session:
        workers.beat(session, "worker-1", now=api.services.database.now())
    found = figures(api)
    assert figure(found, "pvg_jobs", queue="render", state="waiting") == 1
    assert figure(found, "pvg_jobs_ended_total", kind="vectorize", state="succeeded") == 1
    assert figure(found, "pvg_workers", state="ready") == 1
    assert figure(found, "pvg_queue_oldest_seconds", queue="vectorize") >= 0
    assert figure(found, "pvg_database_up") == 1
    assert figure(found, "pvg_free_disk_bytes") > 0
    assert 0 <= figure(found, "pvg_reaper_idle_seconds") < 300
    assert figure(found, "pvg_collector_halted") == 0


def test_what_is_told_arrives_and_is_drawn_is_counted(api: Api) -> None:
    video = upload(api, "/videos")["id"]
    told = {"url": "https://receiver.invalid/"}
    body = {"video": video, "looks": [{"reference": video}], "webhook": told}
    assert api.client.post("/v1/transfer", json=body).status_code == 202
    said = {"Tus-Resumable": "1.0.0", "Upload-Length": "20"}
    place = api.client.post("/v1/uploads", headers=said).headers["location"]
    assert api.client.post("/v1/uploads/link", json={}).status_code == 201  # nothing of its file has begun
    piece = {"Tus-Resumable": "1.0.0", "Upload-Offset": "0", "Content-Type": "application/offset+octet-stream"}
    assert api.client.patch(place, headers=piece, content=b"0123").status_code == 204
    with api.services.background.write() as session:
        workers.beat(session, "previews-1", now=api.services.database.now(), kind="previews")
    found = figures(api)
    assert figure(found, "pvg_webhooks", state="waiting") == 1
    assert figure(found, "pvg_webhooks", state="failed") == 0
    assert figure(found, "pvg_uploads") == 1
    assert figure(found, "pvg_stored_bytes", what="part") == 4
    assert figure(found, "pvg_previews", state="asked") == 0
    assert (figure(found, "pvg_preview_workers"), figure(found, "pvg_workers", state="ready")) == (1, 0)
    used = api.client.get("/v1/usage").json()
    assert used["stored_bytes"]["used"] == 20 + 4092 + figure(found, "pvg_stored_bytes", what="source")
    assert api.client.delete(place, headers={"Tus-Resumable": "1.0.0"}).status_code == 204
    assert figure(figures(api), "pvg_uploads") == 0


def test_the_number_of_ended_jobs_never_falls(api: Api) -> None:
    database = api.services.background
    video = upload(api, "/videos")
    make_ready(api.services, video["id"])
    make_results(api.services, transfer(api, video["id"], video["id"])["id"], [b"one"])
    reference = upload(api, "/references")
    lease = claim(database, reference["job"])
    with database.write() as session:
        assert leases.fail(session, lease, PROBLEM, now=database.now(), timings={})
    ended = {key: value for key, value in figures(api).items() if key[0] == "pvg_jobs_ended_total"}
    assert sum(ended.values()) == 3
    api.client.delete(f"/v1/videos/{video['id']}")
    api.client.delete(f"/v1/references/{reference['id']}")
    removed = 0
    for _ in range(2):  # the second round adds to what the first has counted
        with database.write() as session:
            removed += sweep.expire_jobs(session, before=database.now() + timedelta(seconds=1))
        after = {key: value for key, value in figures(api).items() if key[0] == "pvg_jobs_ended_total"}
        assert after == ended
    assert removed == 3


@pytest.fixture(params=["", "scrape-me"])
def closed(request: pytest.FixtureRequest, settings: Settings) -> Iterator[tuple[Api, str, str]]:
    """A service with a key, with and without a token for its figures."""
    token = request.param
    for api in serve(settings.model_copy(update={"metrics_token": SecretStr(token)})):
        database = api.services.background
        with database.write() as session:
            _, text = keys.create(session, "studio", keys.Limits(), now=database.now())
        yield api, token, text


def test_with_keys_nobody_sees_them_but_who_has_the_token(closed: tuple[Api, str, str]) -> None:
    api, token, key = closed
    for headers in ({}, {"Authorization": f"Bearer {key}"}, {"Authorization": "Bearer wrong"}):
        answer = api.client.get("/metrics", headers=headers)
        assert (answer.status_code, answer.json()["code"]) == (401, "unauthorized")
        assert token == "" or token not in answer.text
    answer = api.client.get("/metrics", headers={"Authorization": f"Bearer {token or 'x'}"})
    assert answer.status_code == (200 if token else 401)
    assert "studio" not in answer.text


def test_without_keys_they_are_shown_while_the_database_is_away_whatever_was_asked_before(
    api: Api, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert api.client.get("/v1/videos").status_code == 200

    @contextmanager
    def away(_: Database) -> Iterator[Session]:
        raise OperationalError("BEGIN", None, _cannot_open())
        yield

    monkeypatch.setattr(Database, "read", away)
    assert figure(figures(api), "pvg_database_up") == 0


def _cannot_open() -> sqlite3.OperationalError:
    error = sqlite3.OperationalError("unable to open database file")
    error.sqlite_errorcode = sqlite3.SQLITE_CANTOPEN
    return error


def test_usage_and_limits_of_a_key(closed: tuple[Api, str, str]) -> None:
    api, _, key = closed
    headers = {"Authorization": f"Bearer {key}"}
    for path in ("/v1/limits", "/v1/usage"):
        assert api.client.get(path).status_code == 401
    limits = api.client.get("/v1/limits", headers=headers).json()
    assert limits["key"] == {"requests_per_minute": 600, "active_jobs": 1000, "stored_bytes": 100 * 1024**3}
    video = api.client.post("/v1/videos", content=b"\x89PNG\r\n\x1a\n", headers=headers).json()
    usage = api.client.get("/v1/usage", headers=headers).json()
    assert usage["active_jobs"] == {"used": 1, "limit": 1000}
    assert usage["stored_bytes"]["used"] == video["size_bytes"]
    assert 0 < usage["requests"]["used"] <= 600
    assert 0 < usage["requests"]["resets_s"] <= 60
    make_ready(api.services, video["id"])
    made = api.client.post(
        "/v1/transfer", json={"video": video["id"], "looks": [{"reference": video["id"]}] * 2}, headers=headers
    ).json()
    make_results(api.services, made["id"], [b"one", b"two"])
    usage = api.client.get("/v1/usage", headers=headers).json()
    assert (usage["looks_this_month"], usage["jobs_this_month"]) == (2, {"succeeded": 2})
    assert usage["active_jobs"]["used"] == 0


def names(text: str) -> set[str]:
    return set(re.findall(r"\b(?:pvg|process)_[a-z_]+\b", text))


def test_rules_and_dashboard_ask_for_figures_that_there_are(api: Api) -> None:
    api.client.get("/v1/videos")
    there = {name for name, _ in figures(api)}
    rules = (OPS / "alerts.yml").read_text()
    expressions = re.findall(r"expr: (.*)", rules)
    assert len(expressions) >= 6
    assert 'up{job="pvg"} == 0' in expressions
    assert {"absent(pvg_database_up)", "max(pvg_preview_workers) == 0"} <= set(expressions)
    dashboard = json.loads((OPS / "dashboard.json").read_text())
    targets = [target["expr"] for panel in dashboard["panels"] for target in panel.get("targets", [])]
    assert len(targets) >= 8
    for expression in [*expressions, *targets]:
        asked = names(expression)
        assert asked or expression.startswith("up{"), expression  # that is Prometheus' own
        assert asked <= there, expression
