"""Limits of media that the settings raise hold for every job on a clip, not for its first one alone."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

import pvg
from pvg.video import read_frames
from scripts.samples import Samples
from service.catalog import media
from service.settings import Settings
from tests.gallery.clips import encode_raw, libav_frame
from tests.service.fixtures import Api
from worker.app import app
from worker.previews.open_clips import Clip, OpenClips
from worker.run import media_limits
from worker.runner import Runner
from worker.sandbox import Sandbox, SandboxServer, calls


@pytest.fixture
def settings(settings: Settings) -> Settings:
    return settings.model_copy(update={"max_frame_rate": 500.0})


@pytest.fixture(scope="module")
def fast(samples: Samples, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four frames, 300 of them a second; 240 are usual."""
    pictures = [libav_frame(frame.rgb()) for frame in read_frames(samples.woman_clip, start=20, stop=24)]
    return encode_raw(tmp_path_factory.mktemp("fast") / "fast.mp4", pictures, "libx264", rate=300)


def test_a_clip_within_raised_limits_is_vectorised_drawn_and_previewed(
    api: Api, warm_server: SandboxServer, fast: Path
) -> None:
    sandbox = Sandbox(warm_server.lobby)
    runner = Runner(api.services.settings, app, sandbox)

    def done(job: str) -> dict[str, Any]:
        runner.run(job)
        body: dict[str, Any] = api.client.get(f"/jobs/{job}").json()
        return body

    video = api.client.post("/videos", files={"file": ("fast.mp4", fast.read_bytes())}).json()
    assert done(video["job"])["state"] == "succeeded"
    looks = [{"reference": video["id"]}]
    job = api.client.post("/transfer", json={"video": video["id"], "looks": looks}).json()["id"]
    body = done(job)
    assert body["state"] == "succeeded", body

    with api.services.database.read() as session:
        medium = media.get(session, video["id"])
    assert medium is not None
    clips = OpenClips(api.services.settings, api.services.storage, sandbox, lambda ids: {})
    question = {"layer": None, "params": None, "before": False, "crop": None, "face": None, "max_width": 320}
    question |= {"frame": 1, "time_s": None, "nearest": False, "format": "jpeg"}
    try:
        answer, _ = clips.ask(Clip(medium, None), question, "still.jpg", time.monotonic() + 60)
    finally:
        for entry in list(clips._entries.values()):
            clips._close(entry)
    assert answer == {"frame": 1, "width": 320, "height": 180}


def test_a_clip_drawn_in_parts_is_held_to_the_same_limits(settings: Settings, fast: Path, tmp_path: Path) -> None:
    limits = media_limits(settings)
    asset = tmp_path / "fast.pvg"
    pvg.vectorize(fast, asset=asset, limits=pvg.MediaLimits(**limits)).close()  # type: ignore[arg-type]
    output = {"codec": "auto", "crf": None, "preset": None, "audio": "copy", "extras": []}
    shared: dict[str, Any] = {"asset": str(asset), "source": str(fast), "looks": [], "output": output}
    shared |= {"container": "mp4", "memory_bytes": 2**40, "limits": limits}
    drawn = {"paths": [], "start": 0, "stop": 4}
    assert calls.CALLS["render_part"](shared | drawn, lambda *_: None).keys() == {"timings"}
    with pytest.raises(pvg.MediaError, match="at most 240"):
        calls.CALLS["render_part"](shared | drawn | {"limits": {}}, lambda *_: None)
