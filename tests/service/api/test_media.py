from __future__ import annotations

from typing import Any

import pytest

from service.api.examples import MEDIUM
from service.catalog import leases, media
from service.settings import Settings
from tests.service.fixtures import MP4, PNG, Api, claim, make_ready, make_results, serve
from tests.service.servers import fresh_database
from tests.waiting import until

PROBLEM = {"type": "no-face", "title": "No face was found", "detail": "no face found in any of 20 frames of a.mp4"}
#: as it is shown
SHOWN = PROBLEM | {"type": "/docs/problems#no-face", "code": "no-face"}


def upload(api: Api, path: str, tail: bytes = b"") -> dict[str, Any]:
    answer = api.client.post(path, content=(MP4 if path == "/videos" else PNG) + tail)
    assert answer.status_code == 202, answer.text
    body: dict[str, Any] = answer.json()
    return body


def transfer(api: Api, video: str, *references: str) -> dict[str, Any]:
    body = {"video": video, "looks": [{"reference": one} for one in references]}
    answer = api.client.post("/transfer", json=body)
    assert answer.status_code == 202, answer.text
    job: dict[str, Any] = answer.json()
    return job


def test_a_ready_medium_shows_what_was_found(api: Api) -> None:
    video = upload(api, "/videos")
    make_ready(api.services, video["id"], faces=2)
    body = api.client.get(f"/videos/{video['id']}").json()
    assert (body["state"], body["error"]) == ("ready", None)
    assert [face["index"] for face in body["faces"]] == [0, 1]
    assert body["media"] == MEDIUM["media"]
    assert body["created_at"].endswith("Z")


def test_a_failed_medium_says_why_and_is_tried_again_when_uploaded_again(api: Api) -> None:
    video = upload(api, "/videos")
    lease = claim(api.services.database, video["job"])
    with api.services.background.write() as session:
        assert leases.fail(session, lease, PROBLEM, now=api.services.database.now(), timings={})
    body = api.client.get(f"/videos/{video['id']}").json()
    assert (body["state"], body["error"]) == ("failed", SHOWN)
    again = api.client.post("/videos", content=MP4)
    assert again.status_code == 202
    assert again.json()["id"] == video["id"]
    assert again.json()["job"] != video["job"]
    assert (again.json()["state"], again.json()["error"]) == ("vectorizing", None)
    make_ready(api.services, video["id"])
    assert api.client.get(f"/videos/{video['id']}").json()["state"] == "ready"


@pytest.mark.parametrize("picture", ["poster", "faces/0/thumbnail", "frames/0"])
def test_a_failed_medium_whose_picture_is_asked_for_is_named_by_the_path_alone(api: Api, picture: str) -> None:
    """The request has no JSON that a pointer could lead into."""
    video = upload(api, "/videos")
    lease = claim(api.services.database, video["job"])
    with api.services.background.write() as session:
        assert leases.fail(session, lease, PROBLEM, now=api.services.database.now(), timings={})
    refused = api.client.get(f"/videos/{video['id']}/{picture}")
    assert (refused.status_code, refused.json()["code"]) == (422, "no-face")
    assert "errors" not in refused.json()


def test_a_file_that_is_sent_again_while_its_job_is_being_canceled_is_vectorised_by_another(api: Api) -> None:
    video = upload(api, "/videos")
    waiting = transfer(api, video["id"], video["id"])["id"]
    lease = claim(api.services.database, video["job"])
    assert api.client.post(f"/jobs/{video['job']}/cancel").json()["state"] == "canceling"
    again = api.client.post("/videos", content=MP4)
    assert (again.status_code, again.json()["id"], again.json()["state"]) == (202, video["id"], "vectorizing")
    assert again.json()["job"] != video["job"]
    assert api.client.get(f"/jobs/{video['job']}").json()["state"] == "canceled"
    with api.services.background.write() as session:  # its worker comes late
        assert not leases.confirm_cancel(session, lease, now=api.services.database.now())
    make_ready(api.services, video["id"])
    assert api.client.get(f"/videos/{video['id']}").json()["state"] == "ready"
    claim(api.services.database, waiting)


def test_a_medium_whose_asset_is_made_again_shows_no_addresses_of_pictures(api: Api) -> None:
    video = upload(api, "/videos")["id"]
    make_ready(api.services, video)
    lease = claim(api.services.database, transfer(api, video, video)["id"])
    with api.services.background.write() as session:
        lost = media.assets(session, [video])
        assert media.make_again(session, lease, lost, now=api.services.database.now())
    shown = api.client.get(f"/videos/{video}").json()
    assert (shown["state"], shown["poster"]) == ("vectorizing", None)
    assert [face["thumbnail"] for face in shown["faces"]] == [None]


def test_lists_page_through_everything_newest_first(api: Api) -> None:
    ids = [upload(api, "/videos", bytes([i]))["id"] for i in range(5)]
    upload(api, "/references")
    seen: list[str] = []
    cursor = None
    for _ in range(3):
        page = api.client.get("/videos", params={"limit": 2} | ({"cursor": cursor} if cursor else {})).json()
        seen += [one["id"] for one in page["data"]]
        cursor = page["next_cursor"]
    assert seen == ids[::-1]
    assert cursor is None
    assert len(api.client.get("/references").json()["data"]) == 1
    assert api.client.get("/videos", params={"cursor": "yesterday"}).status_code == 422


def test_lists_are_filtered_by_state_and_metadata(api: Api) -> None:
    for path in ("/videos", "/references"):
        made = [
            api.client.post(f"{path}?metadata={pair}&metadata=who:me", content=MP4 + pair.encode()).json()["id"]
            for pair in ("order:42", "order:43", "order:42 ")
        ]
        make_ready(api.services, made[0])

        def listed(where: str = path, **query: object) -> list[str]:
            return [one["id"] for one in api.client.get(where, params=query).raise_for_status().json()["data"]]

        assert listed() == made[::-1]
        assert listed(state="ready") == listed(metadata="order:42") == made[:1]
        assert listed(state=["ready", "vectorizing"], metadata="who:me") == made[::-1]
        assert listed(state="vectorizing", metadata=["order:43", "who:me"]) == made[1:2]
        assert listed(state="failed") == listed(metadata="who:you") == []
        assert listed(metadata="who:me", cursor=made[1]) == made[:1]
        for wrong in ("state=done", "metadata=order", "metadata=a:1&metadata=a:2"):
            assert api.client.get(f"{path}?{wrong}").status_code == 422


def test_ids_with_a_nul_are_not_found(postgres_url: str, settings: Settings) -> None:
    """PostgreSQL takes no such text at all."""
    with fresh_database(postgres_url) as url:
        for api in serve(settings.model_copy(update={"database_url": url})):
            for path in ("videos", "references", "jobs", "results"):
                answer = api.client.get(f"/{path}/a%00b")
                assert (answer.status_code, answer.json()["code"]) == (404, "not-found")


def test_unknown_ids_and_ids_of_the_other_kind_are_not_found(api: Api) -> None:
    video, reference = upload(api, "/videos"), upload(api, "/references")
    for path in (
        f"/videos/vid_{'0' * 32}",
        "/videos/nonsense",
        f"/videos/{reference['id']}",
        f"/references/{video['id']}",
    ):
        for answer in (api.client.get(path), api.client.delete(path)):
            assert answer.status_code == 404
            assert answer.json()["code"] == "not-found"


def test_delete_removes_every_derived_byte(api: Api) -> None:
    video, other = upload(api, "/videos"), upload(api, "/videos", b"other")
    reference = upload(api, "/references")
    for medium in (video, other, reference):
        make_ready(api.services, medium["id"])
    mine = make_results(api.services, transfer(api, video["id"], reference["id"])["id"], [b"mine"])
    theirs = make_results(api.services, transfer(api, other["id"], other["id"])["id"], [b"theirs"])
    with_reference = make_results(api.services, transfer(api, other["id"], reference["id"])["id"], [b"ref"])
    assert len(api.blobs) == 9
    gone = api.client.delete(f"/videos/{video['id']}")
    # a client that reads what the type says would find no JSON in it
    assert (gone.status_code, gone.content, gone.headers.get("content-type")) == (204, b"", None)
    assert api.client.get(f"/videos/{video['id']}").status_code == 404
    assert api.client.get(f"/results/{mine[0]}").status_code == 404
    until(lambda: len(api.blobs) == 6)  # an answer waits for a store to delete, but not for ever
    assert not [key for key in api.blobs if video["id"] in key or mine[0] in key]
    # a result made with a reference goes with the reference
    assert api.client.delete(f"/references/{reference['id']}").status_code == 204
    assert api.client.get(f"/results/{with_reference[0]}").status_code == 404
    assert api.client.get(f"/results/{theirs[0]}").content == b"theirs"
    until(lambda: len(api.blobs) == 3)
    # what was deleted may come back
    assert upload(api, "/videos")["id"] != video["id"]


def test_the_same_bytes_in_another_role_survive_a_delete(api: Api) -> None:
    video = upload(api, "/videos")
    reference = api.client.post("/references", content=MP4).json()
    assert video["sha256"] == reference["sha256"]
    assert api.client.delete(f"/videos/{video['id']}?cancel_jobs=true").status_code == 204
    until(lambda: len(api.blobs) == 1)
    (key,) = api.blobs
    assert reference["id"] in key


def test_a_medium_is_deleted_only_as_what_it_was(api: Api) -> None:
    for path in ("/videos", "/references"):
        place = f"{path}/{upload(api, path)['id']}"
        former = api.client.get(place).headers["etag"]
        make_ready(api.services, place.rpartition("/")[2])
        refused = api.client.delete(place, headers={"if-match": former})
        assert (refused.status_code, refused.json()["code"]) == (412, "precondition-failed")
        assert api.client.get(f"{place}/file", headers={"if-match": former}).status_code == 412
        now = api.client.get(place, headers={"if-none-match": former}).headers["etag"]
        assert api.client.delete(place, headers={"if-match": now}).status_code == 204
        assert api.client.get(place).status_code == 404


def test_delete_is_refused_while_jobs_need_the_medium(api: Api) -> None:
    video, reference = upload(api, "/videos"), upload(api, "/references")
    vectorizing = api.client.delete(f"/videos/{video['id']}")
    assert (vectorizing.status_code, vectorizing.json()["code"]) == (409, "conflict")
    make_ready(api.services, video["id"])
    make_ready(api.services, reference["id"])
    job = transfer(api, video["id"], reference["id"])
    for path in (f"/videos/{video['id']}", f"/references/{reference['id']}"):
        refused = api.client.delete(path)
        assert refused.status_code == 409
        assert job["id"] in refused.json()["detail"]
    make_results(api.services, job["id"], [b"done"])
    assert api.client.delete(f"/videos/{video['id']}").status_code == 204


def test_delete_with_cancel_jobs_takes_the_lease_from_the_worker(api: Api) -> None:
    video = upload(api, "/videos")
    make_ready(api.services, video["id"])
    job = transfer(api, video["id"], video["id"])
    lease = claim(api.services.database, job["id"])
    assert api.client.delete(f"/videos/{video['id']}?cancel_jobs=true").status_code == 204
    assert api.client.get(f"/jobs/{job['id']}").json()["state"] == "canceled"
    with api.services.database.read() as session:
        assert leases.held_state(session, lease) is None
    until(lambda: api.blobs == [])


def test_the_uploaded_file_is_had_whole_and_in_ranges(api: Api) -> None:
    content = MP4 + bytes(range(256))
    name = {"Content-Disposition": "attachment; filename*=UTF-8''my%20cl%C3%AFp.mp4"}
    video = api.client.post("/videos", content=content, headers=name).json()
    path = f"/videos/{video['id']}/file"
    whole = api.client.get(path)
    assert (whole.status_code, whole.content, whole.headers["content-type"]) == (200, content, "video/mp4")
    assert whole.headers["etag"] == f'"{video["sha256"]}"'
    assert whole.headers["content-disposition"] == (
        "inline; filename=\"my cl_p.mp4\"; filename*=UTF-8''my%20cl%C3%AFp.mp4"
    )
    part = api.client.get(path, headers={"Range": "bytes=10-19"})
    assert (part.status_code, part.content) == (206, content[10:20])
    assert api.client.get(path, headers={"If-None-Match": whole.headers["etag"]}).status_code == 304
    assert api.client.get(path, headers={"Range": "bytes=9999-"}).status_code == 416
    assert api.client.head(path).headers["content-length"] == str(len(content))
    reference = api.client.post("/references", content=PNG).json()["id"]
    assert api.client.get(f"/references/{reference}/file").content == PNG
    assert api.client.get(f"/videos/{reference}/file").status_code in {404, 422}
    assert api.client.delete(f"/videos/{video['id']}?cancel_jobs=true").status_code == 204
    assert api.client.get(path).status_code == 404
