"""Files that are gone from the storage: an asset is made again, a source is asked for."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import pytest

from pvg.asset import VectorVideo
from pvg.asset.writing import replace_manifest
from pvg.vectorization import VECTORIZER_VERSION
from scripts.samples import Samples
from service.catalog import media
from tests.service.fixtures import Api
from worker.app import app
from worker.runner import Runner
from worker.sandbox import Sandbox, SandboxServer

Run = Callable[[str], dict[str, Any]]


@pytest.fixture
def run(api: Api, warm_server: SandboxServer) -> Run:
    """Do a job in this process; the answer that shows it afterwards."""
    runner = Runner(api.services.settings, app, Sandbox(warm_server.lobby))

    def do(job_id: str) -> dict[str, Any]:
        runner.run(job_id)
        body: dict[str, Any] = api.client.get(f"/jobs/{job_id}").json()
        return body

    return do


def blob(api: Api, video: str, kind: str) -> Path:
    with api.services.database.read() as session:
        found = media.get(session, video)
    assert found is not None
    assert api.services.settings.local_storage_folder is not None
    return api.services.settings.local_storage_folder / str(getattr(found, f"{kind}_key"))


def test_a_lost_asset_is_made_again_once_and_a_lost_source_is_asked_for(
    api: Api, run: Run, samples: Samples, tmp_path: Path
) -> None:
    picture = cv2.imread(str(samples.dark_portrait))
    small = cv2.resize(picture, None, fx=(factor := 480 / max(picture.shape)), fy=factor)
    cv2.imwrite(str(file := tmp_path / "me.png"), small)

    def upload() -> dict[str, Any]:
        answer = api.client.post("/videos", files={"file": ("me.png", file.read_bytes())})
        return {**answer.json(), "status": answer.status_code}

    def transfer() -> str:
        looks = [{"reference": video["id"]}]
        return str(api.client.post("/transfer", json={"video": video["id"], "looks": looks}).json()["id"])

    def medium() -> dict[str, Any]:
        body: dict[str, Any] = api.client.get(f"/videos/{video['id']}").json()
        return body

    video = upload()
    assert run(video["job"])["state"] == "succeeded"
    job_id = transfer()
    blob(api, video["id"], "asset").unlink()
    body = run(job_id)
    assert (body["state"], body["waiting_for"], medium()["state"]) == ("queued", "media", "vectorizing")
    assert run(medium()["job"])["state"] == "succeeded"
    assert medium()["state"] == "ready"

    # damaged again: it is not tried for ever
    whole = blob(api, video["id"], "asset").read_bytes()
    blob(api, video["id"], "asset").write_bytes(whole[:-1000])
    body = run(job_id)
    assert (body["state"], body["error"]["code"]) == ("failed", "asset-invalid")
    blob(api, video["id"], "asset").write_bytes(whole)

    # whole, and not of this clip: neither file is named, nor its folder
    source = blob(api, video["id"], "source")
    source.write_bytes(cv2.imencode(".png", small // 2)[1].tobytes())
    error = run(transfer())["error"]
    assert error["code"] == "asset-invalid"
    assert f"{video['id']} is not the clip that the vectorised {video['id']} was made from" in error["detail"]
    assert source.name not in error["detail"]

    source.unlink()
    body = run(transfer())
    assert (body["state"], body["attempt"], body["error"]["code"]) == ("failed", 1, "source-lost")
    assert "upload it again" in body["error"]["detail"]
    assert (upload()["status"], medium()["state"]) == (200, "ready")
    assert run(transfer())["state"] == "succeeded"


def test_an_asset_of_an_earlier_vectoriser_is_made_again_before_it_is_drawn(
    api: Api, run: Run, samples: Samples, tmp_path: Path
) -> None:
    small = cv2.resize(cv2.imread(str(samples.dark_portrait)), (400, 500))
    cv2.imwrite(str(file := tmp_path / "me.png"), small)
    video = api.client.post("/videos", files={"file": ("me.png", file.read_bytes())}).json()
    assert run(video["job"])["state"] == "succeeded"

    def made_earlier(**otherwise: object) -> None:
        asset = blob(api, video["id"], "asset")
        with VectorVideo(asset) as opened:
            replace_manifest(asset, {**opened.manifest, "vectorizer": VECTORIZER_VERSION - 1, **otherwise})

    def vectorizer() -> object:
        with VectorVideo(blob(api, video["id"], "asset")) as opened:
            return opened.manifest["vectorizer"]

    def made_again() -> None:
        again = api.client.get(f"/videos/{video['id']}").json()["job"]
        assert run(again)["state"] == "succeeded"

    def transfer(strength: float) -> str:
        body = {"video": video["id"], "looks": [{"reference": video["id"], "strength": strength}]}
        return str(api.client.post("/transfer", json=body).json()["id"])

    made_earlier()
    job_id, another = transfer(1.0), transfer(0.7)
    for one in (job_id, another):  # the second is taken while it is made again, and does not draw by the earlier one
        body = run(one)
        assert (body["state"], body["waiting_for"], body["attempt"]) == ("queued", "media", 1)
    made_again()
    assert vectorizer() == VECTORIZER_VERSION
    assert run(job_id)["state"] == "succeeded"

    # an earlier worker, which still runs beside this one, has made it again: it is drawn as it is, and not for ever
    made_earlier()
    assert run(another)["state"] == "succeeded"
    third = transfer(0.5)
    assert run(third)["waiting_for"] == "media"
    made_again()
    assert run(third)["state"] == "succeeded"

    # one without a face, whoever made it: nothing can be drawn on it
    made_earlier(vectorizer=VECTORIZER_VERSION, faces=[])
    fourth = transfer(0.3)
    assert run(fourth)["waiting_for"] == "media"
    made_again()
    assert run(fourth)["state"] == "succeeded"


def test_a_medium_whose_source_was_lost_before_it_was_vectorised_is_healed_by_an_upload(api: Api, run: Run) -> None:
    def upload() -> dict[str, Any]:
        body: dict[str, Any] = api.client.post("/references", files={"file": ("me.png", b"\x89PNG\r\n\x1a\nx")}).json()
        return body

    first = upload()
    blob(api, first["id"], "source").unlink()
    body = run(first["job"])
    assert (body["state"], body["error"]["code"]) == ("failed", "source-lost")
    again = upload()
    assert (again["id"], again["state"]) == (first["id"], "vectorizing")
    assert blob(api, first["id"], "source").exists()
    assert run(again["job"])["error"]["code"] == "media-invalid"  # the file is there, and no picture
