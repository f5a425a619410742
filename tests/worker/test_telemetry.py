from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from scripts.samples import Samples
from service.processes import worker_environment
from service.settings import Settings
from tests.promises import Drill
from tests.pvg.test_silence import environment, home, left_behind
from tests.service.servers import installed
from tests.worker.serving import running_service

__all__ = ["home"]


def test_the_worker_leaves_no_device_id_and_no_events_of_onnxruntime(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("CI", "ORT_DISABLE_TELEMETRY", "ORT_RUNNING_UNIT_TESTS"):  # each switches it off as well
        monkeypatch.delenv(name, raising=False)
    home = {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    environment = worker_environment(Settings(data_dir=tmp_path / "data")) | home
    subprocess.run([sys.executable, "-c", "import onnxruntime"], env=environment, check=True, timeout=300)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_the_service_speaks_to_nobody_but_its_clients(
    home: Path,
    samples: Samples,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    promise: Callable[..., Drill],
) -> None:
    """API, worker and pool seen from outside, while they vectorise and render."""
    drill = promise("R20", wanted="no packet to another machine, no device id on disk")
    strace = installed("strace")
    for name in os.environ.keys() - environment(home).keys():
        monkeypatch.delenv(name)
    monkeypatch.setenv("HOME", str(home))
    log = tmp_path / "calls"
    # -D: the service is our child, and strace beside it
    before = (
        strace,
        "-D",
        "-f",
        "--seccomp-bpf",
        "-qq",
        "-e",
        "trace=connect,sendto,sendmsg,sendmmsg",
        "-o",
        str(log),
    )
    with running_service(tmp_path, before=before, worker_concurrency="1") as service:
        video = service.ready("/videos", samples.portrait)
        reference = service.ready("/references", samples.dark_portrait)
        look = {"reference": reference["id"]}
        job = service.client.post("/transfer", json={"video": video["id"], "looks": [look]}).json()
        assert service.finished(job["id"])["state"] == "succeeded"
        time.sleep(6)
    calls = log.read_text().splitlines()
    assert any("sendto" in call for call in calls)  # the answers to the client above
    outside = [call for call in calls if re.search(r"sa_family=AF_(?!UNIX)", call)]
    drill.measured = (
        f"{len(calls)} calls of the network seen, {len(outside)} to an address; {len(left_behind(home))} files"
    )
    assert outside == []
    assert left_behind(home) == []
