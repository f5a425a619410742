"""The API where none of the method's libraries is installed, as in its image; a worker elsewhere does the jobs."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from scripts.samples import Samples
from tests.install.environments import REPOSITORY, Environment, bare_environment, build, environment, run, succeeds
from tests.service.servers import free_port

LOCK = REPOSITORY / "requirements" / "api.txt"
pytestmark = pytest.mark.timeout(1800)


@contextmanager
def running(log: Path, *command: str | Path, **variables: str) -> Iterator[subprocess.Popen[bytes]]:
    """A process that is ended like a container: by SIGTERM."""
    with log.open("wb") as output:
        process = subprocess.Popen(
            [str(part) for part in command],
            env=environment(**variables),
            cwd="/",
            stdout=output,
            stderr=output,
            start_new_session=True,
        )
        try:
            yield process
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait(timeout=60)


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Environment:
    """What requirements/api.txt names, with its hashes, and our own package; no more."""
    folder = tmp_path_factory.mktemp("api")
    python = shutil.which("python3.11") or sys.executable
    made = bare_environment(folder / "environment", python)
    made.install("--require-hashes", "-r", LOCK)
    wheel, _ = build(folder)
    made.install("--no-deps", wheel)
    return made


def test_it_lacks_the_method(service: Environment) -> None:
    script = (
        "from importlib.util import find_spec\n"
        "print([name for name in ('av', 'cv2', 'numba', 'numpy', 'onnxruntime', 'scipy') if find_spec(name)])"
    )
    assert succeeds(service.python, "-c", script) == "[]\n"


def test_it_takes_a_file_and_a_worker_elsewhere_does_the_job(
    service: Environment, samples: Samples, tmp_path: Path
) -> None:
    port = free_port()
    variables = {"PVG_PORT": str(port), "PVG_DATA_DIR": str(tmp_path / "data")}
    variables |= {name: os.environ[name] for name in ("PVG_CACHE_DIR",) if name in os.environ}
    command = service.command("pvg-service")
    api, worker = tmp_path / "api.log", tmp_path / "worker.log"
    client = httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60)
    with client, running(api, command, "serve", "--no-worker", **variables) as process:
        deadline = time.monotonic() + 120
        while run(command, "health", **variables).returncode != 0:
            assert process.poll() is None, api.read_text()
            assert time.monotonic() < deadline, api.read_text()
        ready = client.get("/readyz").raise_for_status().json()
        assert (ready["status"], ready["checks"]["workers"]) == ("degraded", "none")
        assert succeeds(command, "health", **variables) == "degraded: workers none\n"
        with samples.dark_portrait.open("rb") as file:
            job = client.post("/references", files={"file": file}).raise_for_status().json()["job"]
        assert client.get(f"/jobs/{job}").json()["state"] == "queued"
        full = Path(sys.executable).with_name("pvg-service")
        with running(worker, full, "worker", **variables):
            deadline = time.monotonic() + 300
            while not (body := client.get(f"/jobs/{job}", params={"wait": 5}).json())["done"]:
                assert time.monotonic() < deadline, worker.read_text()
            assert body["state"] == "succeeded", worker.read_text()
            assert succeeds(command, "health", "--worker", **variables).startswith("ok: ")
