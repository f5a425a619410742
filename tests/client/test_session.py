"""What a user of the client does, against the real service."""

from __future__ import annotations

import asyncio
import hashlib
import os
import socket
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import httpx
import pytest

from pvg.video import probe
from pvg_client import ApiError, AsyncClient, Client, DamagedError, Job, JobFailed, Look, Medium, UnreachableError
from scripts.samples import Samples
from tests.client.lines import Line
from tests.conftest import cut_clip


@pytest.fixture(scope="package")
def video(url: str, clip: Path) -> Medium:
    with Client(url) as client:
        return client.upload(clip, metadata={"shot": "a7"})


@pytest.fixture(scope="package")
def reference(url: str, samples: Samples) -> Medium:
    with Client(url) as client:
        return client.upload(samples.dark_portrait, role="reference")


@pytest.fixture(scope="package")
def drawn(url: str, video: Medium, reference: Medium) -> Job:
    """A job of two looks, one of them with a cube beside it."""
    looks = [Look(reference), Look(reference.id, strength=0.5, protect=["eyes"], makeup={"lips": 1.0})]
    with Client(url) as client:
        return client.wait(client.transfer(video, looks, output={"extras": ["cube"]}, metadata={"order": "42"}))


def test_an_upload_is_known_by_its_name_and_its_bytes(client: Client, video: Medium, clip: Path) -> None:
    assert (video.role, video.filename, video.size_bytes) == ("video", clip.name, clip.stat().st_size)
    assert video.sha256 == hashlib.sha256(clip.read_bytes()).hexdigest()
    assert video.metadata == {"shot": "a7"}
    assert client.upload(clip, metadata={"shot": "a7"}).id == video.id


def test_an_uploaded_file_comes_back(client: Client, video: Medium, clip: Path, tmp_path: Path) -> None:
    by_id, in_a_folder = client.download(video.id, tmp_path / "by-id.mp4"), client.download(video, tmp_path)
    assert in_a_folder == tmp_path / clip.name
    assert by_id.read_bytes() == in_a_folder.read_bytes() == clip.read_bytes()


def test_a_medium_is_waited_for_and_says_what_it_is(client: Client, video: Medium) -> None:
    job = client.wait(video)
    assert (job.kind, job.state, job.media) == ("vectorize", "succeeded", video.id)
    ready = client.medium(video.id)
    assert ready.state == "ready"
    assert ready.media is not None
    assert (ready.media.width, ready.media.height, ready.media.frame_count) == (640, 360, 12)
    (face,) = ready.faces
    assert (face.first_frame, face.last_frame) == (0, 11)
    assert face.width_px > 64
    assert len(face.skin_rgb) == 3


def test_looks_are_drawn_as_asked(drawn: Job) -> None:
    assert (drawn.kind, drawn.state, drawn.done, drawn.metadata) == ("transfer", "succeeded", True, {"order": "42"})
    assert drawn.progress.fraction == 1
    first, second = drawn.looks
    assert (first.options["strength"], second.options["strength"]) == (1.0, 0.5)
    assert second.options["protect"] == ["eyes"]
    assert second.options["makeup"]["lips"] == 1.0
    assert len(drawn.results) == 2
    assert drawn.finished_at is not None
    assert drawn.finished_at > drawn.created_at


def test_a_download_is_the_file_and_leaves_nothing_else(client: Client, drawn: Job, tmp_path: Path) -> None:
    target = tmp_path / "look.mp4"
    target.write_bytes(b"what was there before")
    assert client.download(drawn.results[0], target) == target
    assert hashlib.sha256(target.read_bytes()).hexdigest() == drawn.results[0].sha256
    assert probe(target).frame_count == 12
    assert client.download(drawn.results[0].id, tmp_path / "by-id.mp4").read_bytes() == target.read_bytes()
    assert client.download(drawn.looks[0], tmp_path / "of-a-look.mp4").read_bytes() == target.read_bytes()
    (cube,) = drawn.results[0].extras
    assert b"LUT_3D_SIZE 33" in client.download(cube, tmp_path / "look.cube").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["by-id.mp4", "look.cube", "look.mp4", "of-a-look.mp4"]


def test_files_of_one_job_stand_beside_each_other_in_a_folder(
    client: Client, drawn: Job, clip: Path, samples: Samples, tmp_path: Path
) -> None:
    files = [file for result in drawn.results for file in (result, *result.extras)]
    paths = [client.download(file, tmp_path) for file in files]
    stem = f"{clip.stem}-{samples.dark_portrait.stem}"
    assert [path.name for path in paths] == [
        f"{stem}.mp4",
        f"{stem}-look.cube",
        f"{stem}-2.mp4",
        f"{stem}-2-look.cube",
    ]
    assert [hashlib.sha256(path.read_bytes()).hexdigest() for path in paths] == [file.sha256 for file in files]


def test_a_broken_download_goes_on_where_it_broke(url: str, drawn: Job, tmp_path: Path) -> None:
    size = drawn.results[0].size_bytes
    assert size is not None
    line = Line(cuts=3, cut_bytes=size // 5)
    with Client(url, transport=line, retries=1) as client:
        path = client.download(drawn.results[0], tmp_path / "look.mp4")
    assert hashlib.sha256(path.read_bytes()).hexdigest() == drawn.results[0].sha256
    begins = [begin for _, _, begin in line.seen]
    assert begins == [None, *(f"bytes={k * (size // 5)}-" for k in (1, 2, 3))]
    assert line.received_bytes == size


def test_another_run_goes_on_with_a_download(url: str, drawn: Job, tmp_path: Path) -> None:
    size = drawn.results[0].size_bytes
    assert size is not None
    broken = Line(cuts=1, cut_bytes=size // 2)
    with Client(url, transport=broken, retries=0) as client, pytest.raises(UnreachableError):
        client.download(drawn.results[0], tmp_path / "look.mp4")
    assert not (tmp_path / "look.mp4").exists()
    line = Line()
    with Client(url, transport=line) as client:
        client.download(drawn.results[0], tmp_path / "look.mp4")
    assert line.received_bytes == size - size // 2
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("kept", ["half", "whole", "more"])
def test_damaged_bytes_are_fetched_again(url: str, drawn: Job, tmp_path: Path, kept: str) -> None:
    result = drawn.results[0]
    assert result.size_bytes is not None
    assert result.sha256 is not None
    size = {"half": result.size_bytes // 2, "whole": result.size_bytes, "more": result.size_bytes + 7}[kept]
    (tmp_path / f".look.mp4.{result.sha256[:16]}.part").write_bytes(os.urandom(size))
    line = Line()
    with Client(url, transport=line) as client:
        path = client.download(result, tmp_path / "look.mp4")
    assert hashlib.sha256(path.read_bytes()).hexdigest() == result.sha256
    assert [begin for _, _, begin in line.seen] == [f"bytes={size}-", None]


def test_bytes_that_stay_wrong_are_not_handed_out(client: Client, drawn: Job, tmp_path: Path) -> None:
    with pytest.raises(DamagedError):
        client.download(replace(drawn.results[0], sha256="0" * 64), tmp_path / "look.mp4")
    assert list(tmp_path.iterdir()) == []


def test_a_broken_upload_is_sent_again_and_done_once(url: str, samples: Samples) -> None:
    size = samples.pale_portrait.stat().st_size
    line = Line(cuts=2, cut_bytes=size // 2)
    with Client(url, transport=line) as client:
        medium = client.upload(samples.pale_portrait, role="reference", resume=False)
        assert medium.sha256 == hashlib.sha256(samples.pale_portrait.read_bytes()).hexdigest()
        assert [one.id for one in client.references()].count(medium.id) == 1
    assert line.sent_bytes == size // 2 * 2 + size


def test_lists_are_gone_through_page_by_page(client: Client, url: str, drawn: Job, video: Medium) -> None:
    everything = list(client.jobs())
    assert [job.id for job in everything] == sorted((job.id for job in everything), reverse=True)
    assert [job.id for job in client.jobs(kind=["transfer"], metadata={"order": "42"}, video=video)] == [drawn.id]
    assert [job.id for job in client.jobs(ids=[drawn.id, "job_unknown"])] == [drawn.id]
    order, reference = {"order": "42"}, drawn.looks[0].reference
    assert list(client.jobs(state=["queued", "running"], metadata=order, video=video)) == []
    assert [job.id for job in client.jobs(reference=reference, metadata=order, video=video)] == [drawn.id]
    assert list(client.jobs(reference="ref_unknown", metadata=order, video=video)) == []
    assert video.id in {one.id for one in client.videos()}
    assert video.id in {one.id for one in client.videos(state=["ready"])}
    assert list(client.videos(state=["ready"], metadata={"nobody": "has"})) == []


def test_the_same_for_asyncio(
    url: str, clip: Path, video: Medium, drawn: Job, samples: Samples, tmp_path: Path
) -> None:
    async def session() -> Path:
        async with AsyncClient(url) as client:
            again, reference = await asyncio.gather(
                client.upload(clip, metadata={"shot": "a7"}), client.upload(samples.dark_portrait, role="reference")
            )
            assert again.id == video.id
            job = await client.wait(await client.transfer(again, reference=reference, force=True))
            assert job.id in [one.id async for one in client.jobs(kind=["transfer"])]
            return await client.download(job.results[0], tmp_path / "look.mp4")

    assert probe(asyncio.run(session())).frame_count == 12


def test_a_job_is_followed_to_its_end(client: Client, url: str, video: Medium, reference: Medium, drawn: Job) -> None:
    changes = list(client.events(client.transfer(video, [Look(reference, strength=0.75)])))
    states = [job.state for job in changes]
    assert states[-1] == "succeeded"
    assert set(states) <= {"queued", "running", "succeeded"}
    assert [job.done for job in changes] == [False] * (len(changes) - 1) + [True]
    fractions = [job.progress.fraction for job in changes]
    assert fractions == sorted(fractions)
    # of one that has ended there is its end alone
    assert [job.id for job in client.events(drawn.id)] == [drawn.id]

    async def followed() -> list[Job]:
        async with AsyncClient(url) as other:
            job = await other.transfer(video, [Look(reference, strength=0.76)])
            return [change async for change in other.events(job)]

    assert asyncio.run(followed())[-1].state == "succeeded"


def test_who_stops_listening_holds_no_stream(url: str, video: Medium, reference: Medium) -> None:
    with Client(url) as client:
        job = client.transfer(video, [Look(reference, strength=0.77)])
        listening = client.events(job)
        next(listening)
        listening.close()  # type: ignore[attr-defined]
        assert client.wait(job).done


def test_a_link_is_opened_without_the_client(client: Client, drawn: Job, tmp_path: Path) -> None:
    link = client.link(drawn.looks[0], expires_in_s=600)
    answer = httpx.get(link.url, timeout=60)
    assert hashlib.sha256(answer.content).hexdigest() == drawn.results[0].sha256
    assert 500 < (link.expires_at - datetime.now(UTC)).total_seconds() <= 600
    cube = httpx.get(client.link(drawn.results[0].id, part="look.cube").url, timeout=60)
    assert b"LUT_3D_SIZE 33" in cube.content
    assert httpx.get(link.url[:-2], timeout=60).status_code == 403


def test_limits_and_usage_are_told(client: Client, drawn: Job) -> None:
    limits, usage = client.limits(), client.usage()
    assert limits.key is None
    assert limits.upload["bytes"] > 0
    assert limits.transport["uploads"] > 0
    assert "h264" in limits.output["clips"]["mp4"]
    assert usage.looks_this_month >= len(drawn.results)
    assert usage.jobs_this_month["succeeded"] >= 1
    month = usage.months[0]
    assert (month.looks, month.jobs) == (usage.looks_this_month, usage.jobs_this_month)
    assert month.frames >= month.looks
    assert month.uploads > 0 < month.upload_bytes
    assert (usage.stored_bytes.used > 0, usage.stored_bytes.limit) == (True, None)


def test_a_url_within_the_services_network_is_not_fetched(client: Client, url: str) -> None:
    with pytest.raises(ApiError) as caught:
        client.upload(url=f"{url}/v1/limits")
    assert caught.value.code == "url-not-allowed"
    for given in ({}, {"file": "clip.mp4", "url": "https://media.example/clip.mp4"}):
        with pytest.raises(ValueError, match="a file, or a url"):
            client.upload(**given)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="no role 'portrait'"):
        client.upload("portrait.jpg", role="portrait")  # type: ignore[arg-type]


def test_swap_gives_both(client: Client, url: str, video: Medium, drawn: Job, samples: Samples) -> None:
    other = client.upload(samples.pale_portrait)
    job = client.wait(client.swap(video, other, options={"contrast": [0.9, "auto"]}))
    assert [look.video for look in job.looks] == [video.id, other.id]
    assert [look.options["contrast"] for look in job.looks] == [0.9, "auto"]
    client.delete(other)
    with pytest.raises(ApiError) as caught:
        client.medium(other.id)
    assert caught.value.status == 404


def test_a_failed_job_says_why(client: Client, samples: Samples, tmp_path: Path) -> None:
    faceless = client.upload(cut_clip(samples.no_face_clip, tmp_path / "faceless.mp4", 0, 6))
    with pytest.raises(JobFailed) as caught:
        client.wait(faceless)
    assert caught.value.problem.code == "no-face"
    assert caught.value.job.state == "failed"
    failed = client.medium(faceless.id)
    assert failed.error is not None
    assert failed.error.code == "no-face"


def test_a_canceled_job_is_told_apart(client: Client, samples: Samples) -> None:
    medium = client.upload(samples.woman_full)
    with pytest.raises(TimeoutError, match="vectorize job_"):
        client.wait(medium, timeout=0)
    assert client.cancel(medium.job).state in {"canceled", "canceling"}
    with pytest.raises(JobFailed) as caught:
        client.wait(medium)
    assert caught.value.job.state == "canceled"


def test_what_is_not_allowed_is_named(client: Client, video: Medium, reference: Medium) -> None:
    with pytest.raises(ApiError) as caught:
        client.transfer(video, [Look(reference, strength=2.0)])
    error = caught.value
    assert (error.status, error.code) == (422, "validation-failed")
    assert [one.pointer for one in error.errors] == ["/looks/0/strength"]
    assert error.title
    assert error.detail in str(error)
    assert str(error.request_id) in str(error)


def test_a_key_of_ones_own_makes_a_call_once(client: Client, video: Medium, reference: Medium) -> None:
    looks = [Look(reference, strength=0.25)]
    first = client.transfer(video, looks, force=True, idempotency_key="order-43")
    again = client.transfer(video, looks, force=True, idempotency_key="order-43")
    assert again.id == first.id
    client.wait(first)


def test_looks_and_a_reference_are_one_or_the_other(client: Client) -> None:
    for given in ({}, {"looks": [Look("ref_1")], "reference": "ref_1"}):
        with pytest.raises(ValueError, match="one reference"):
            client.transfer("vid_1", **given)  # type: ignore[arg-type]


def test_nobody_at_the_address_is_said_in_one_line() -> None:
    with socket.socket() as silent:  # has the port, and does not listen
        silent.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{silent.getsockname()[1]}"
        with Client(url, retries=0) as client, pytest.raises(UnreachableError, match="/jobs"):
            client.job("job_1")


def test_an_address_is_checked() -> None:
    for address in ("127.0.0.1:8000", "ftp://example.test", ""):
        with pytest.raises(ValueError, match="no address of a service"):
            Client(address)
