"""/usage: what a key has had done by month, whatever becomes of it."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import insert

from service.api.examples import MEDIUM
from service.catalog import ledger
from service.catalog.models import MonthlyUsage
from service.reaper import Reaper
from tests.service.api.test_authentication import Holder, holder
from tests.service.api.test_media import transfer, upload
from tests.service.fixtures import MP4, PNG, Api, make_ready, make_results

OF_CLIP = MEDIUM["media"]


def this_month(caller: Holder | Api) -> dict[str, Any]:
    answer = caller.get("/usage") if isinstance(caller, Holder) else caller.client.get("/usage")
    usage: dict[str, Any] = answer.json()
    first: dict[str, Any] = usage["months"][0]
    assert (usage["looks_this_month"], usage["jobs_this_month"]) == (first["looks"], first["jobs"])
    return first


def test_a_month_in_which_nothing_was_done_is_there_too(api: Api) -> None:
    (month,) = api.client.get("/usage").json()["months"]
    assert re.fullmatch(r"20\d\d-\d\d", month.pop("month"))
    assert month == {"jobs": {}, "looks": 0, "frames": 0, "duration_s": 0, "uploads": 0, "upload_bytes": 0}
    assert api.client.get("/limits").json()["retention"]["usage_months"] == 25


def test_what_is_deleted_stays_counted(api: Api) -> None:
    one, other = holder(api), holder(api)
    video, reference = one.upload().json(), one.upload("/references", PNG).json()
    for medium in (video, reference):
        make_ready(api.services, medium["id"])
    body = {"video": video["id"], "looks": [{"reference": reference["id"]}] * 2}
    job = one.post("/transfer", json=body).json()["id"]
    assert this_month(one)["looks"] == 0
    make_results(api.services, job, [b"one", b"two"])
    counted = this_month(one)
    assert counted == {
        "month": ledger.month_of(api.services.database.now()),
        "jobs": {"succeeded": 3},
        "looks": 2,
        "frames": 2 * OF_CLIP["frame_count"],
        "duration_s": 2 * OF_CLIP["duration_s"],
        "uploads": 2,
        "upload_bytes": len(MP4) + len(PNG),
    }
    for path in (f"/jobs/{job}", f"/videos/{video['id']}", f"/jobs/{video['job']}", f"/references/{reference['id']}"):
        assert one.delete(path).status_code == 204, path
    assert this_month(one) == counted
    assert this_month(other)["jobs"] == {}


def test_what_is_asked_for_again_counts_once(api: Api) -> None:
    once = {"Idempotency-Key": "order-42"}
    video = api.client.post("/videos", content=MP4, headers=once).json()["id"]
    for headers in (once, {}):
        assert api.client.post("/videos", content=MP4, headers=headers).json()["id"] == video
    make_ready(api.services, video)
    body = {"video": video, "looks": [{"reference": video}]}
    once = {"Idempotency-Key": "order-43"}
    job = api.client.post("/transfer", json=body, headers=once).json()["id"]
    make_results(api.services, job, [b"one"])
    for headers in (once, {}):
        assert api.client.post("/transfer", json=body, headers=headers).json()["id"] == job
    counted = this_month(api)
    assert (counted["uploads"], counted["upload_bytes"]) == (1, len(MP4))
    assert (counted["jobs"], counted["looks"]) == ({"succeeded": 2}, 1)
    # made again, and sent again after it was deleted, is done again
    forced = api.client.post("/transfer", json=body | {"force": True}).json()["id"]
    make_results(api.services, forced, [b"two"])
    assert api.client.delete(f"/videos/{video}").status_code == 204
    assert api.client.post("/videos", content=MP4).status_code == 202
    counted = this_month(api)
    assert (counted["uploads"], counted["jobs"], counted["looks"]) == (2, {"succeeded": 3}, 2)


def test_jobs_that_end_with_their_medium_are_counted_as_canceled(api: Api) -> None:
    video = upload(api, "/videos")
    transfer(api, video["id"], video["id"])
    assert api.client.delete(f"/videos/{video['id']}?cancel_jobs=true").status_code == 204
    counted = this_month(api)
    assert (counted["jobs"], counted["looks"], counted["uploads"]) == ({"canceled": 2}, 0, 1)


def test_former_months_are_told_the_newest_first(api: Api) -> None:
    with api.services.background.write() as session:
        for month, looks in (("2026-01", 3), ("2025-12", 4)):
            session.execute(insert(MonthlyUsage).values(owner="", month=month, looks=looks, milliseconds=1500))
        session.execute(insert(MonthlyUsage).values(owner="key_a", month="2026-02", looks=5))
    _, *former = api.client.get("/usage").json()["months"]
    assert [(one["month"], one["looks"], one["duration_s"]) for one in former] == [
        ("2026-01", 3, 1.5),
        ("2025-12", 4, 1.5),
    ]


def test_the_reaper_removes_months_past_their_retention(api: Api) -> None:
    services = api.services
    with services.background.write() as session:
        for month in ("1999-12", ledger.month_of(datetime.now(UTC))):
            session.execute(insert(MonthlyUsage).values(owner="", month=month))
    reaper: Reaper = services.reaper
    assert reaper.expire() == 1
    with services.database.read() as session:
        assert "1999-12" not in {one.month for _, one in ledger.every(session)}
    assert reaper.expire() == 0
