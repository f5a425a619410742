"""A thousand queued jobs of one key, and one of another: R12."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest

from scripts.samples import Samples
from service.catalog import Database, keys, utc_now
from service.catalog.keys import Limits
from service.settings import Settings
from tests.faults.renders import small_picture, transfer
from tests.promises import Drill
from tests.worker.serving import Service, running_service

pytestmark = [pytest.mark.slow, pytest.mark.timeout(2400)]

MANY, CLIENTS = 1000, 4
#: seconds for all of them
ENOUGH_S = 2000


@dataclass(frozen=True)
class Thousand:
    """What was seen.

    queued: how many waited when the last had come. posts, gets: seconds of each request. passed: how many of the
    thousand the other key's job came before, and ``before`` how many began between its request and itself. ended: how
    each ended, by its id, in all lists of jobs; begun: how often each was.
    """

    ids: list[str]
    queued: int
    posts: list[float]
    gets: list[float]
    passed: int
    before: int
    ended: dict[str, str]
    begun: Counter[str]
    drained_s: float


def new_key(service: Service, name: str) -> httpx.Client:
    """A client with a key that may ask for as much as it likes."""
    database = Database(Settings(data_dir=service.data_dir).database)
    with database.write() as session:
        _, text = keys.create(session, name, Limits(10**6, 10**4), now=utc_now())
    database.close()
    client = service.new_client()
    client.headers["Authorization"] = f"Bearer {text}"
    return client


def done(client: httpx.Client, job_id: str) -> None:
    """Wait until a job has ended."""
    until = time.monotonic() + ENOUGH_S
    while not client.get(f"/jobs/{job_id}?wait=30").raise_for_status().json()["done"]:
        assert time.monotonic() < until


def ready(client: httpx.Client, file: Path) -> str:
    """The id of a video of this client that is ready."""
    medium = client.post("/videos", content=file.read_bytes()).raise_for_status().json()
    done(client, medium["job"])
    return str(medium["id"])


def fill(service: Service, many: httpx.Client, video: str) -> tuple[list[str], list[float], list[float]]:
    """Ask for a thousand jobs, four clients at once, beside one that reads: their ids, and the seconds of each call."""
    ids: list[str] = []
    posts: list[float] = []
    gets: list[float] = []
    full = threading.Event()

    def ask(number: int) -> None:
        with service.new_client() as client:
            client.headers["Authorization"] = many.headers["Authorization"]
            for seed in range(MANY // CLIENTS):
                began = time.perf_counter()
                ids.append(transfer(client, video, MANY * number + seed))
                posts.append(time.perf_counter() - began)

    def look() -> None:
        with service.new_client() as client:
            client.headers["Authorization"] = many.headers["Authorization"]
            while not full.wait(0.02):
                if ids:
                    began = time.perf_counter()
                    client.get(f"/jobs/{ids[len(gets) * 37 % len(ids)]}").raise_for_status()
                    gets.append(time.perf_counter() - began)

    looking = threading.Thread(target=look)
    looking.start()
    try:
        with ThreadPoolExecutor(CLIENTS) as clients:
            list(clients.map(ask, range(CLIENTS)))
    finally:
        full.set()
        looking.join()
    return ids, posts, gets


def listed(client: httpx.Client) -> dict[str, str]:
    """How every job of a client stands, page by page."""
    found: dict[str, str] = {}
    cursor = ""
    while True:
        page = client.get("/jobs", params={"limit": 100} | ({"cursor": cursor} if cursor else {})).json()
        found |= {job["id"]: f"{job['state']}, attempt {job['attempt']}" for job in page["data"]}
        cursor = page.get("next_cursor")
        if not cursor:
            return found


@pytest.fixture(scope="module")
def thousand(samples: Samples, tmp_path_factory: pytest.TempPathFactory) -> Thousand:
    """Both slots draw clips while a thousand jobs of one key come; then comes another key's, and all are waited for."""
    folder = tmp_path_factory.mktemp("many")
    picture = small_picture(samples.portrait, folder, 240)
    with (
        running_service(folder, worker_concurrency="2", patient=False) as service,
        new_key(service, "many") as many,
        new_key(service, "few") as few,
    ):
        video, other = ready(many, picture), ready(few, picture)
        clip = ready(many, samples.woman_clip)
        for first in (0, 8):
            transfer(many, clip, *range(first, first + 8))
        ids, posts, gets = fill(service, many, video)
        began_s = time.monotonic()

        def order() -> list[str]:
            return [line["job"] for line in service.events("job begins")]

        earlier = order()
        late = transfer(few, other, 1)
        done(few, late)
        later = order()
        for job_id in ids:
            done(many, job_id)
        drained_s = time.monotonic() - began_s
        ended = listed(many)
        begun = Counter(order())
    return Thousand(
        ids=ids,
        queued=len(set(ids) - set(earlier)),
        posts=posts,
        gets=gets,
        passed=len(set(ids) - set(later[: later.index(late)])),
        before=later.index(late) - len(earlier),
        ended={job_id: ended.get(job_id, "lost") for job_id in ids},
        begun=begun,
        drained_s=drained_s,
    )


def test_a_thousand_queued_jobs_hold_nobody_up(thousand: Thousand, promise: Callable[..., Drill]) -> None:
    drill = promise("R12", wanted="1000 queued, 2 workers: POST p99 < 200 ms, GET p99 < 100 ms")
    post, get = (1000 * sorted(times)[int(0.99 * len(times))] for times in (thousand.posts, thousand.gets))
    drill.measured = f"{thousand.queued} queued, 4 clients at once: POST p99 {post:.0f} ms, GET p99 {get:.0f} ms"
    assert len(set(thousand.ids)) == MANY
    drill.keep_to(post, 200)
    drill.keep_to(get, 100)


def test_none_of_a_thousand_queued_jobs_is_lost(thousand: Thousand, promise: Callable[..., Drill]) -> None:
    drill = promise("R12", wanted="none lost: each of the thousand is done, once")
    states = Counter(thousand.ended.values())
    times = Counter(thousand.begun[job_id] for job_id in thousand.ids)
    drill.measured = f"{dict(states)} after {thousand.drained_s:.0f} s; times begun {dict(times)}"
    assert states == {"succeeded, attempt 1": MANY}
    assert times == {1: MANY}


def test_another_keys_job_passes_a_thousand_queued_ones(thousand: Thousand, promise: Callable[..., Drill]) -> None:
    drill = promise("R12", wanted="fair between keys: another key's job passes the thousand")
    drill.measured = f"came before {thousand.passed} of {thousand.queued} queued ones, after {thousand.before} of them"
    assert thousand.queued >= MANY // 2
    # those whose message a slot had taken when it came
    assert thousand.before <= 4
