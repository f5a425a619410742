"""`pvg-service serve` as a user starts it, for tests that talk to the real thing."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx

from tests.service.servers import free_port


@dataclass(frozen=True)
class Service:
    """A running service, and every process that belongs to it."""

    client: httpx.Client
    process: subprocess.Popen[bytes]
    data_dir: Path
    log: Path

    def processes(self) -> dict[int, str]:
        """Pid and command line of all processes of this service, however they were started."""
        return processes_of(self.data_dir)

    def upload(self, path: str, file: Path) -> dict[str, Any]:
        with file.open("rb") as data:
            answer = self.client.post(path, files={"file": (file.name, data)})
        assert answer.status_code in {200, 202}, answer.text
        body: dict[str, Any] = answer.json()
        return body

    def finished(self, job_id: str, seconds: float = 120) -> dict[str, Any]:
        """The job once it is done."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            body: dict[str, Any] = self.client.get(f"/jobs/{job_id}?wait=10").raise_for_status().json()
            if body["done"]:
                return body
        raise AssertionError(f"not done after {seconds} s: {body}\n{self.log.read_text()[-4000:]}")

    def ready(self, path: str, file: Path) -> dict[str, Any]:
        """Upload and wait for the vectorisation."""
        medium = self.upload(path, file)
        job = self.finished(medium["job"])
        assert job["state"] == "succeeded", job
        body: dict[str, Any] = self.client.get(f"{path}/{medium['id']}").json()
        return body


def processes_of(data_dir: Path) -> dict[int, str]:
    """Every living process whose environment names this data folder."""
    marker = f"PVG_DATA_DIR={data_dir}".encode()
    found = {}
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            if marker in (entry / "environ").read_bytes().split(b"\0"):
                found[int(entry.name)] = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        except OSError:
            continue  # it ended, is a zombie, or is another user's
    return found


def wait_until_gone(data_dir: Path, seconds: float) -> dict[int, str]:
    """Processes that are still there after so many seconds."""
    until = time.monotonic() + seconds
    while (left := processes_of(data_dir)) and time.monotonic() < until:
        time.sleep(0.1)
    return left


@contextmanager
def running_service(folder: Path, *, cwd: Path | None = None, **settings: str) -> Iterator[Service]:
    """Start the service with these settings (without their prefix), stop it with Ctrl-C's signal."""
    data_dir, log = folder / "data", folder / "service.log"
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PVG_")}
    environment |= {"PVG_DATA_DIR": str(data_dir), "PVG_PORT": str(port := free_port()), "OMP_NUM_THREADS": "1"}
    environment |= {f"PVG_{name.upper()}": value for name, value in settings.items()}
    command = [str(Path(sys.executable).with_name("pvg-service")), "serve"]
    with log.open("wb") as output:
        process = subprocess.Popen(
            command, cwd=cwd, env=environment, stdout=output, stderr=output, start_new_session=True
        )
    try:
        with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60) as client:
            until = time.monotonic() + 60
            while True:
                assert process.poll() is None, log.read_text()
                assert time.monotonic() < until, log.read_text()
                try:
                    if client.get("/readyz").is_success:
                        break
                except httpx.TransportError:
                    time.sleep(0.1)
            yield Service(client, process, data_dir, log)
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(40)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        for pid in processes_of(data_dir):
            os.kill(pid, signal.SIGKILL)
