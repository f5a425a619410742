"""The commands of the images where nothing but /data and a tmpfs can be written, and without any capability."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from scripts.samples import Samples
from tests.service.servers import check_namespaces, free_port
from tests.worker.read_only_root import CANNOT

ROOT = Path(__file__).resolve().parents[2]
SERVICE = str(Path(sys.executable).with_name("pvg-service"))
NAMESPACES = ("unshare", "--user", "--map-root-user", "--mount")
ENTER = (*NAMESPACES, sys.executable, "-m", "tests.worker.read_only_root")


class Container:
    """What a container of ours has: a volume, a tmpfs, and settings as variables."""

    def __init__(self, folder: Path, **settings: str) -> None:
        self.volume, self.tmp = folder / "volume", folder / "tmp"
        for path in (self.volume, self.tmp):
            path.mkdir()
        self.environment = {name: value for name, value in os.environ.items() if not name.startswith("PVG_")}
        self.environment |= {name: os.environ[name] for name in ("PVG_CACHE_DIR",) if name in os.environ}
        # a home of its own: what is read of the true one is named
        self.environment.setdefault("PVG_CACHE_DIR", str(Path.home() / ".cache" / "pvg"))
        self.environment |= {"PVG_DATA_DIR": str(self.volume / "pvg"), **settings}

    def command(self, *command: str) -> Sequence[str]:
        return (*ENTER, str(self.volume), str(self.tmp), *command)

    def run(self, *command: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            self.command(*command),
            env=self.environment,
            cwd=ROOT,
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )

    @contextmanager
    def running(self, log: Path, *command: str) -> Iterator[subprocess.Popen[bytes]]:
        with log.open("wb") as output:
            process = subprocess.Popen(
                self.command(*command),
                env=self.environment,
                cwd=ROOT,
                stdout=output,
                stderr=output,
                start_new_session=True,
            )
            try:
                yield process
            finally:
                process.send_signal(signal.SIGTERM)
                try:
                    assert process.wait(120) == 0, log.read_text()
                except subprocess.TimeoutExpired:
                    os.killpg(process.pid, signal.SIGKILL)
                    process.wait()
                    raise


@pytest.fixture(scope="module", autouse=True)
def compiled_kernels() -> None:
    """As the image has them. Where they are, as after `make setup`, nothing is compiled again."""
    subprocess.run([sys.executable, "-m", "pvg.warmup"], cwd=ROOT, capture_output=True, check=True, timeout=900)


@pytest.fixture
def container(tmp_path: Path) -> Container:
    made = Container(tmp_path, PVG_PORT=str(free_port()), PVG_WORKER_CONCURRENCY="1")
    check_namespaces(*NAMESPACES)
    if (done := made.run("/bin/true")).returncode != 0:
        assert done.returncode == CANNOT, done.stderr
        pytest.skip(f"mounts in a namespace are not to be had here: {done.stderr.strip()}")
    return made


def test_nothing_else_can_be_written(container: Container) -> None:
    tried = f"touch {ROOT}/x /usr/x /var/x /etc/x {container.volume}/in-volume {container.tmp}/in-tmp; exit 0"
    said = container.run("/bin/sh", "-c", tried).stderr
    assert len(re.findall("Read-only file system", said)) == 4, said
    assert said.count("\n") == 4
    assert (container.volume / "in-volume").exists()
    assert not (container.tmp / "in-tmp").exists(), "that is a tmpfs of its own"
    status = container.run("/bin/cat", "/proc/self/status").stdout
    assert set(re.findall(r"^Cap(?:Inh|Prm|Eff|Bnd|Amb):\t(\w+)$", status, re.MULTILINE)) == {"0" * 16}
    assert "NoNewPrivs:\t1" in status


def test_api_and_worker_do_a_job(container: Container, samples: Samples, tmp_path: Path) -> None:
    """As in the profile `scaled`: the API and the worker apart, each asked by its own health check."""
    api, worker = tmp_path / "api.log", tmp_path / "worker.log"
    base = f"http://127.0.0.1:{container.environment['PVG_PORT']}"
    with httpx.Client(base_url=base, timeout=60) as client, container.running(api, SERVICE, "serve", "--no-worker"):
        _until(lambda: container.run(SERVICE, "health").returncode == 0, api)
        with samples.dark_portrait.open("rb") as file:
            job = client.post("/references", files={"file": file}).raise_for_status().json()["job"]
        assert container.run(SERVICE, "health", "--worker").returncode == 1
        with container.running(worker, SERVICE, "worker") as process:

            def is_done() -> bool:
                assert process.poll() is None, worker.read_text()
                return bool(client.get(f"/jobs/{job}", params={"wait": 5}).json()["done"])

            _until(is_done, worker)
            assert client.get(f"/jobs/{job}").json()["state"] == "succeeded", worker.read_text()
            assert container.run(SERVICE, "health", "--worker").stdout.startswith("ok: 1 alive")
    assert "compiles its kernels" not in worker.read_text(), "they lie there compiled: `python -m pvg.warmup`"
    assert "Read-only file system" not in api.read_text() + worker.read_text()
    assert "the sandbox of jobs is not whole" not in worker.read_text()
    assert {path.name for path in container.volume.iterdir()} == {"pvg"}


def _until(reached: Callable[[], bool], log: Path) -> None:
    deadline = time.monotonic() + 240
    while not reached():
        assert time.monotonic() < deadline, log.read_text()
        time.sleep(0.2)
