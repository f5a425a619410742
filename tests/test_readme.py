"""The sessions that the READMEs show, as they stand there but for the address of the service."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from pvg.video import probe
from scripts.samples import SAMPLES_DIR, Samples
from tests.conftest import REPOSITORY, cut_clip
from tests.service.servers import installed
from tests.worker.serving import Service, running_service

ADDRESS = "http://127.0.0.1:8000"
FRAMES = 12
_SESSION = re.compile(r"^<!-- tested: (\w+) -->\n```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def session(readme: str, name: str) -> tuple[str, str]:
    """The language and the text of a session."""
    found = {one[1]: (one[2], one[3]) for one in _SESSION.finditer((REPOSITORY / readme).read_text("utf-8"))}
    return found[name]


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    with running_service(tmp_path_factory.mktemp("service")) as running:
        yield running


@pytest.fixture
def folder(samples: Samples, tmp_path: Path) -> Path:
    """What the sessions find beside them."""
    cut_clip(samples.woman_clip, tmp_path / "clip.mp4", 20, 20 + FRAMES)
    cut_clip(samples.single_face_clip, tmp_path / "b.mp4", 0, 3)
    shutil.copy(samples.dark_portrait, tmp_path / "portrait.jpg")
    shutil.copy(samples.pale_portrait, tmp_path / "a.jpg")
    return tmp_path


def run(readme: str, name: str, folder: Path, service: Service | None = None) -> str:
    """Run a session in a folder; what it printed."""
    language, text = session(readme, name)
    if service is not None:
        assert ADDRESS in text
        text = text.replace(ADDRESS, str(service.client.base_url).rstrip("/"))
    command = {"python": [sys.executable, "-c"], "sh": ["sh", "-euc"]}[language]
    # also where the client is not installed beside the service
    paths = [str(REPOSITORY / "client" / "src"), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    began = time.monotonic()
    done = subprocess.run(
        [*command, text], cwd=folder, env=environment, capture_output=True, text=True, timeout=500, check=False
    )
    print(f"{readme}, {name}: {time.monotonic() - began:.1f} s")
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_session_of_the_client(service: Service, folder: Path) -> None:
    run("README.md", "client", folder, service)
    assert [probe(folder / f"look-{number}.mp4").frame_count for number in (1, 2)] == [FRAMES, FRAMES]
    assert (folder / "look-1.mp4").read_bytes() != (folder / "look-2.mp4").read_bytes()


def test_the_session_of_curl(service: Service, folder: Path) -> None:
    for tool in ("curl", "jq"):
        installed(tool)
    printed = run("README.md", "curl", folder, service)
    assert probe(folder / "look.mp4").frame_count == FRAMES
    assert '"kind":"transfer"' in printed.splitlines()[-1]


def test_the_session_of_the_library(folder: Path) -> None:
    run("README.md", "library", folder)
    assert [probe(folder / name).frame_count for name in ("look-a.mp4", "look-b.mp4")] == [FRAMES, FRAMES]


def test_the_sessions_of_the_librarys_page(folder: Path) -> None:
    cv2.imwrite(str(folder / "ground.png"), np.full((200, 200, 3), 90, np.uint8))
    page = (REPOSITORY / "docs/library.md").read_text("utf-8")
    assert all(f"`{path.name}`" in page.partition("<!--")[0] for path in folder.iterdir())
    printed = [run("docs/library.md", found[1], folder) for found in _SESSION.finditer(page)]
    assert len(printed) == page.count("```python") == 5
    made = {"look", "1", "2", "clip-as-b"}
    assert [probe(folder / f"{name}.mp4").frame_count for name in sorted(made)] == [FRAMES] * len(made)
    assert (probe(folder / "grade.mov").codec, probe(folder / "small.webm").codec) == ("prores", "vp9")
    assert {path.suffix for path in (folder / "suite").iterdir()} == {".cube", ".mkv", ".txt"}
    assert "ended\n" in printed[3]
    assert "ground.png" in printed[3].splitlines()[-1]
    assert not (folder / "again.pvg").exists()
    assert all(int(count) > 10**8 for count in printed[4].split())


def test_the_session_of_the_clients_readme(service: Service, folder: Path) -> None:
    printed = run("client/README.md", "client", folder, service)
    assert "succeeded [0.8]" in printed
    assert "clip.mp4" in printed.splitlines()[-1]
    assert [probe(folder / name).frame_count for name in ("look.mp4", "look-1.mp4")] == [FRAMES, FRAMES]


def test_the_samples_that_the_readme_names_are_there(samples: Samples) -> None:
    named = re.findall(r"\bvar/samples/(\S+)", (REPOSITORY / "README.md").read_text("utf-8"))
    assert len(named) == 2
    assert all((SAMPLES_DIR / name).is_file() for name in named)
