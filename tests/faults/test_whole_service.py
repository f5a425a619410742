"""Harm to the service on both settings: R2, R5, R18; and a body that is larger than memory, R11."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import httpx
import pytest
import redis
from sqlalchemy import func, select

from scripts.samples import Samples
from service.catalog import Database, Job, Look, Media, Result
from service.catalog.models import Tombstone
from service.queue.broker import QUEUES, RENDER
from service.queue.publisher import Message, make_producer, send
from service.settings import Settings
from tests.folders import files_below
from tests.gallery.clips import cut_clip
from tests.promises import Drill
from tests.service.fixtures import MP4
from tests.service.receivers import Receiver
from tests.waiting import until
from tests.worker.serving import Service, kill_all, service_as, worker_processes

Promise = Callable[..., Drill]


both = pytest.mark.parametrize("setting", ["embedded", "scaled"])


@pytest.mark.slow
@both
def test_another_worker_takes_over(
    setting: str, request: pytest.FixtureRequest, tmp_path: Path, samples: Samples, promise: Promise
) -> None:
    drill = promise("R2", wanted="another worker takes the job over within 45 s")
    with service_as(setting, request, tmp_path) as service:  # times as they are by default
        job = service.upload("/videos", samples.woman_clip)["job"]
        service.at_work(job)
        folder = service.folder_of(job)
        before = worker_processes(folder, 2)
        kill_all(before)
        began = time.monotonic()
        until(lambda: service.job(job)["attempt"] >= 2, 240)
        taken = time.monotonic() - began
        done = service.finished(job)
        drill.measured = f"{setting}: after {taken:.0f} s; {done['state']} on attempt {done['attempt']}"
        if setting == "embedded":  # `serve` starts it again; else another one took the job
            assert not before & worker_processes(folder)
    assert (done["state"], done["attempt"]) == ("succeeded", 2)
    drill.keep_to(taken, 45)


@both
def test_one_message_delivered_ten_times_is_one_job(
    setting: str, request: pytest.FixtureRequest, tmp_path: Path, samples: Samples, promise: Promise
) -> None:
    drill = promise("R5", wanted="10 messages, 4 slots: one render, one end told")
    clip = cut_clip(samples.woman_clip, tmp_path / "clip.mp4", 20, 44)
    settings = {"worker_concurrency": "4" if setting == "embedded" else "2", "allow_private_networks": "true"}
    with Receiver().listening() as receiver, service_as(setting, request, tmp_path, **settings) as service:
        broker = service.settings.get("broker_url", "")
        producer = make_producer(Settings(data_dir=service.data_dir, broker_url=broker))
        video = service.ready("/videos", clip)["id"]
        wanted = {"video": video, "looks": [{"reference": video}], "webhook": {"url": receiver.url}}
        job = service.client.post("/transfer", json=wanted).raise_for_status().json()["id"]
        for _ in range(10):
            send(producer, Message(job, RENDER))
        stream = service.client.get(f"/jobs/{job}/events", timeout=120).text  # until the job has ended
        done = service.finished(job)
        until(lambda: not undone(service), 120, said=lambda: undone(service))
        begun = len(service.events("job begins", job=job))
        receiver.wait_for(1)
        told = stream.count('"done":true'), len(receiver.got)
        drill.measured = (
            f"{setting}: 11 messages, begun {begun} time(s), {done['state']} on attempt {done['attempt']}; told {told}"
        )
        assert (begun, done["state"], done["attempt"]) == (1, "succeeded", 1)
        assert told == (1, 1)  # by the stream of events, and by webhook
        assert service.finished(job) == done


def undone(service: Service) -> int:
    """How many messages wait, or are not acknowledged yet."""
    broker = service.settings.get("broker_url")
    if broker is None:
        return sum(path.suffix == ".msg" for path in files_below(service.data_dir / "broker"))
    with redis.Redis.from_url(broker) as client:
        return int(client.hlen("unacked")) + sum(int(client.llen(queue)) for queue in QUEUES)


@pytest.mark.slow
@both
def test_past_the_retention_nothing_is_left(
    setting: str, request: pytest.FixtureRequest, tmp_path: Path, samples: Samples, promise: Promise
) -> None:
    drill = promise("R18", wanted="rows and bytes gone, 410, disk back to where it was")
    # long enough for a busy machine to start, to make the result and to be asked for it
    settings = {"result_ttl_s": "15", "media_ttl_s": "120", "job_ttl_s": "130", "reap_interval_s": "0.5"}
    with service_as(setting, request, tmp_path, **settings) as service:
        before = stored(service)
        video, reference = (
            service.upload("/videos", samples.portrait),
            service.upload("/references", samples.dark_portrait),
        )
        looks = [{"reference": reference["id"]}]
        job = service.client.post("/transfer", json={"video": video["id"], "looks": looks}).json()
        (look,) = service.finished(job["id"])["looks"]
        held, known = sum(stored(service).values()), sum(rows(service).values())
        answers = [(service.client.get(f"/results/{look['result']}").status_code)]
        end = time.monotonic() + 240
        while stored(service) != before and time.monotonic() < end:
            answers.append(service.client.get(f"/results/{look['result']}").status_code)
            time.sleep(0.2)
        answers.append(service.client.get(f"/videos/{video['id']}").status_code)
        told, left = list(dict.fromkeys(answers)), stored(service)
        more = sum(left.values()) - sum(before.values())
        until(lambda: not sum(rows(service).values()), 120, said=lambda: rows(service))
        drill.measured = (
            f"{setting}: {held / 1e6:.1f} MB held, {more} bytes left; result {told[1:]}; {known} rows, then "
            f"{sum(rows(service).values())}"
        )
        assert left == before
        assert service.client.get(f"/jobs/{job['id']}").status_code in {404, 410}
        assert told == [200, 410, 404]
        assert service.client.get("/references").json()["data"] == []


def rows(service: Service) -> dict[str, int]:
    """How many records there are of what a client made, by table."""
    database = Database(service.settings.get("database_url") or Settings(data_dir=service.data_dir).database)
    with database.read() as session:
        counted = {
            str(table.__tablename__): session.scalar(select(func.count()).select_from(table)) or 0
            for table in (Media, Result, Look, Job, Tombstone)
        }
    database.close()
    return counted


def stored(service: Service) -> dict[str, int]:
    """What is kept, with its size: files of the folders but those of the database, the broker and the room on the
    disk, and what is in S3 but for the store's mark.
    """
    kept = ("catalog", "broker", "reserve")
    files = [
        path
        for path in service.files()
        for folder in service.folders
        if path.is_relative_to(folder) and not path.relative_to(folder).parts[0].startswith(kept)
    ]
    sizes = service.sizes()
    for path in files:
        with suppress(FileNotFoundError):  # it has gone meanwhile
            sizes[str(path)] = path.stat().st_size
    return {name: size for name, size in sizes.items() if not name.endswith("/.database")}


@pytest.mark.slow
@both
def test_a_body_larger_than_memory_leaves_it_as_it_is(
    setting: str, request: pytest.FixtureRequest, tmp_path: Path, promise: Promise
) -> None:
    drill = promise("R11", wanted="a 2 GiB upload: memory grows < 50 MB")
    # the store of the tests holds all of it in memory; a multipart upload is one from 10 MiB on
    size, piece = (2 * 2**30 if setting == "embedded" else 2**28), bytes(2**20)

    def body() -> Iterator[bytes]:
        yield MP4 + piece[len(MP4) :]
        for _ in range(size // len(piece) - 1):
            yield piece

    with service_as(setting, request, tmp_path, max_upload_bytes=str(size)) as service:
        with httpx.Client(base_url=service.client.base_url, timeout=300) as client:  # of one API
            client.post("/videos", content=MP4)
            before = peak_mb(service.process.pid)
            answer = client.post("/videos", content=body())
        grown = peak_mb(service.process.pid) - before
        drill.measured = f"{setting}: {size >> 20} MiB, {answer.status_code}, peak {before:.0f} MB + {grown:.0f} MB"
        assert answer.status_code == 202
        assert grown < 50


def peak_mb(pid: int) -> float:
    return int(Path(f"/proc/{pid}/status").read_text().split("VmHWM:")[1].split()[0]) / 1024
