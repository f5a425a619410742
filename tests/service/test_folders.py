from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import get_args

import pytest

from scripts.samples import Samples
from service.folders import private_folder
from service.queue import make_folders
from service.settings import Settings
from service.storage import Kind
from tests.folders import permissions, umask_of
from tests.service.fixtures import PNG, Api
from tests.worker.serving import Service, running_service, worker_processes


@pytest.fixture(autouse=True)
def usual_umask() -> Iterator[None]:
    with umask_of(0o022):
        yield


@contextmanager
def cores_allowed() -> Iterator[None]:
    """What is started meanwhile may leave a core file."""
    soft, hard = resource.getrlimit(resource.RLIMIT_CORE)
    resource.setrlimit(resource.RLIMIT_CORE, (hard, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_CORE, (soft, hard))


def open_to_others(folder: Path) -> list[str]:
    found: list[str] = []
    for path in (folder, *folder.rglob("*")):
        with suppress(FileNotFoundError):  # a running service removes files
            found += [str(path)] if permissions(path) & 0o077 else []
    return found


def test_a_new_folder_is_closed_and_so_is_what_is_written_later(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path / "a" / "data")
    make_folders(settings)
    assert permissions(settings.folder) == 0o700
    (settings.spool_folder / "draft").write_bytes(b"face")
    assert permissions(settings.spool_folder / "draft") == 0o600
    assert open_to_others(settings.folder) == []


def test_an_open_folder_of_ours_is_closed_with_what_we_keep_in_it(tmp_path: Path) -> None:
    folder = tmp_path / "data"
    (folder / "blobs" / "source").mkdir(parents=True)
    (folder / "part").mkdir()
    ours = ("blobs/source/face.mp4", "part/upload.0", "catalog.sqlite3", "link-secret", "link-secret.draft")
    for name in (*ours, "somebody's.txt"):
        (folder / name).write_bytes(b"x")
    (folder / "blobs" / "link").symlink_to("/etc/hostname")
    before = permissions(Path("/etc/hostname"))
    private_folder(folder)
    assert permissions(folder) == 0o700
    assert {permissions(folder / name) for name in ours} == {0o600}
    assert permissions(folder / "somebody's.txt") == 0o644
    assert permissions(Path("/etc/hostname")) == before


def test_blobs_of_every_kind_are_closed(tmp_path: Path) -> None:
    folder = tmp_path / "blobs"
    for kind in get_args(Kind):
        (folder / kind / "ab").mkdir(parents=True)
        (folder / kind / "ab" / "face").write_bytes(b"x")
    (folder / ".incoming").mkdir()
    private_folder(folder)
    assert open_to_others(folder) == []


def test_a_folder_meant_for_all_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "tmp"
    folder.mkdir()
    folder.chmod(0o1777)
    with pytest.raises(PermissionError, match="choose a folder inside it"):
        private_folder(folder)
    assert permissions(folder) == 0o1777
    private_folder(folder / "data")


def test_a_folder_of_something_else_is_left_as_it_is(tmp_path: Path) -> None:
    folder = tmp_path / "srv"
    (folder / "www").mkdir(parents=True)
    folder.chmod(0o755)
    with pytest.raises(OSError, match="nothing of the service's"):
        make_folders(Settings(data_dir=folder))
    assert [path.name for path in folder.iterdir()] == ["www"]
    assert permissions(folder) == 0o755
    (folder / "www").rename(folder / "lost+found")  # a disk of its own
    make_folders(Settings(data_dir=folder))
    make_folders(Settings(data_dir=folder))
    assert permissions(folder) == 0o700


@pytest.mark.parametrize("names", [("source", "docs"), ("source",), ("spool", "log"), ("pictures", "reserve")])
def test_a_folder_of_something_else_may_have_names_that_ours_have(tmp_path: Path, names: tuple[str, ...]) -> None:
    for name in names:
        (tmp_path / "srv" / name).mkdir(parents=True)
    (tmp_path / "srv").chmod(0o755)
    with pytest.raises(OSError, match="nothing of the service's"):
        private_folder(tmp_path / "srv")
    assert permissions(tmp_path / "srv") == 0o755


@pytest.mark.parametrize(
    "names", [("spool",), ("spool", "broker", "blobs"), ("spool", "other", "link-secret"), ("source", "asset")]
)
def test_a_folder_that_a_service_on_a_server_has_left_open_is_taken(tmp_path: Path, names: tuple[str, ...]) -> None:
    """Without SQLite there may be little in it."""
    for name in names:
        (tmp_path / "data" / name).mkdir(parents=True)
    private_folder(tmp_path / "data")
    assert permissions(tmp_path / "data") == 0o700


def test_a_folder_that_is_closed_already_or_has_a_log_is_taken(tmp_path: Path) -> None:
    closed, logged = tmp_path / "closed", tmp_path / "logged"
    (closed / "settings").mkdir(parents=True)
    closed.chmod(0o700)
    logged.mkdir(mode=0o755)
    (logged / "service.log").touch()
    for folder in (closed, logged):
        make_folders(Settings(data_dir=folder))
        assert permissions(folder) == 0o700


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder away")
def test_the_open_folder_of_another_user_is_refused_in_one_line(tmp_path: Path) -> None:
    folder = tmp_path / "data"
    folder.mkdir(mode=0o755)
    os.chown(folder, 4321, 4321)
    for command in ("serve", "worker", "migrate", "gc"):
        done = subprocess.run(
            [str(Path(sys.executable).with_name("pvg-service")), command],
            env=os.environ | {"PVG_DATA_DIR": str(folder)},
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        assert done.returncode == 1
        assert done.stderr.count("\n") == 1
        assert "chmod 700" in done.stderr
        assert str(folder) in done.stderr
    assert list(folder.iterdir()) == []


def test_uploads_are_for_us_alone(api: Api) -> None:
    assert api.client.post("/references", content=PNG).status_code == 202
    assert len(api.blobs) == 1
    assert open_to_others(api.services.settings.folder) == []


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """Started where files are open to others and cores are left, and in a folder with packages named as its own."""
    folder = tmp_path_factory.mktemp("service")
    for name in ("worker", "service", "pvg", "celery"):
        (folder / name).mkdir()
        (folder / name / "__init__.py").write_text("raise SystemExit('imported from the current folder')")
    with ExitStack() as stack:
        with umask_of(0o022), cores_allowed():
            running = stack.enter_context(running_service(folder, cwd=folder))
        yield running


def test_every_process_of_the_service_keeps_to_itself(service: Service) -> None:
    medium = service.client.post("/references", content=PNG).json()
    assert service.finished(medium["job"])["state"] == "failed"
    umasks, cores = {}, {}
    for pid in service.processes():
        with suppress(FileNotFoundError, ProcessLookupError):  # that of the job ends
            umasks[pid] = Path(f"/proc/{pid}/status").read_text().partition("Umask:\t")[2].split("\n")[0]
            limits = Path(f"/proc/{pid}/limits").read_text()
            cores[pid] = limits.partition("Max core file size")[2].split()[0]
    assert len(umasks) >= 4  # the API, the worker, its pool
    assert set(umasks.values()) == {"0077"}
    assert set(cores.values()) == {"0"}
    assert open_to_others(service.data_dir) == []


def test_packages_in_the_folder_it_is_started_in_are_left_alone(service: Service, samples: Samples) -> None:
    workers = worker_processes(service.data_dir, 3)
    assert service.ready("/references", samples.portrait)["state"] == "ready"
    assert workers <= worker_processes(service.data_dir, 3)
    assert "the worker ended by itself" not in service.log.read_text()
