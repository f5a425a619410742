"""The README's recipe for curl, where something goes wrong: it ends, says why, and makes no file."""

from __future__ import annotations

import re
import subprocess
import threading
from pathlib import Path

import pytest

from service.catalog import leases
from tests.service.api.test_media import PROBLEM
from tests.service.fixtures import MP4, PNG, Api, claim
from tests.service.servers import installed
from tests.waiting import until

README = Path(__file__).resolve().parents[3] / "README.md"


def _pasted(api: Api, folder: Path) -> str:
    """Run the recipe as a shell does that goes on after errors; what it said."""
    for tool in ("curl", "jq"):
        installed(tool)
    found = re.search(r"<!-- tested: curl -->\n```sh\n(.*?)\n# or ", README.read_text("utf-8"), re.DOTALL)
    assert found is not None
    text = found[1].replace("http://127.0.0.1:8000", str(api.client.base_url).rstrip("/"))
    done = subprocess.run(["sh", "-c", text], cwd=folder, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode != 0
    assert not (folder / "look.mp4").exists()
    return done.stderr


@pytest.mark.parametrize("content", [b"no clip", MP4])
def test_the_recipe_ends_where_it_is_refused(api: Api, tmp_path: Path, content: bytes) -> None:
    (tmp_path / "clip.mp4").write_bytes(content)
    (tmp_path / "portrait.jpg").write_bytes(b"no picture")
    assert "is not a video or image of an allowed type" in _pasted(api, tmp_path)


def test_the_recipe_ends_with_a_failed_job(api: Api, tmp_path: Path) -> None:
    (tmp_path / "clip.mp4").write_bytes(MP4)
    (tmp_path / "portrait.jpg").write_bytes(PNG)
    database = api.services.background

    def fail() -> None:
        until(lambda: bool(api.client.get("/jobs?kind=transfer").json()["data"]))
        (video,) = api.client.get("/videos").json()["data"]
        lease = claim(database, video["job"])
        with database.write() as session:
            assert leases.fail(session, lease, PROBLEM, now=database.now(), timings={})
        api.services.reaper.round()

    failing = threading.Thread(target=fail)
    failing.start()
    said = _pasted(api, tmp_path)
    failing.join()
    assert PROBLEM["detail"] in said
