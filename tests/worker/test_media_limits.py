"""What a clip is held to when it is drawn: the limits of the settings, and the memory that its codec takes."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

import pvg
from pvg.memory import rendering_bytes
from pvg.video import probe, read_frames
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


def test_a_clip_over_a_limit_fails_with_it(api: Api, warm_server: SandboxServer, fast: Path) -> None:
    settings = api.services.settings.model_copy(update={"max_frames": 3})
    video = api.client.post("/videos", files={"file": ("fast.mp4", fast.read_bytes())}).json()
    Runner(settings, app, Sandbox(warm_server.lobby)).run(video["job"])
    error = api.client.get(f"/jobs/{video['job']}").json()["error"]
    assert (error["code"], error["limit"], error["unit"]) == ("too-long", 3, "frames")
    assert error["detail"] == "the file has 4 frames; at most 3 are accepted"
    assert api.client.get(f"/videos/{video['id']}").json()["error"] == error
    answer = api.client.post("/transfer", json={"video": video["id"], "looks": [{"reference": video["id"]}]})
    assert answer.status_code == 422
    assert answer.json().items() >= error.items()


def inputs(settings: Settings, clip: Path, asset: Path) -> dict[str, Any]:
    """What every call about looks of a clip is told; there are no looks."""
    output = {"codec": "auto", "crf": None, "preset": None, "audio": "copy", "extras": []}
    shared = {"source": str(clip), "asset": str(asset), "remade": [], "looks": [], "output": output}
    shared |= {"container": "mp4", "memory_bytes": settings.job_memory_bytes}
    return shared | {"limits": media_limits(settings)}


def draw_part(arguments: dict[str, Any], **changes: Any) -> None:
    calls.CALLS["render_part"](arguments | {"paths": [], "start": 0, "stop": 4} | changes, lambda *_: None)


def test_a_clip_drawn_in_parts_is_held_to_the_same_limits(settings: Settings, fast: Path, tmp_path: Path) -> None:
    arguments = inputs(settings, fast, tmp_path / "fast.pvg")
    limits = pvg.MediaLimits(**arguments["limits"])
    pvg.vectorize(fast, asset=arguments["asset"], limits=limits).close()
    draw_part(arguments)
    with pytest.raises(pvg.MediaError, match="at most 240"):
        draw_part(arguments, limits={})


def test_memory_is_asked_for_by_the_codec_that_is_written(settings: Settings, samples: Samples, tmp_path: Path) -> None:
    frames = read_frames(samples.woman_clip, start=20, stop=24)
    deep = [libav_frame(frame.rgb(), "yuv420p10le") for frame in frames]
    clip = encode_raw(tmp_path / "deep.mkv", deep, "ffv1")
    arguments = inputs(settings, clip, tmp_path / "deep.pvg")
    pvg.vectorize(clip, asset=arguments["asset"]).close()
    media = probe(clip)
    needed = [rendering_bytes(media, 1, codec) for codec in ("av1", "hevc")]  # "auto" in WebM and in MP4
    assert needed[0] < needed[1]
    draw_part(arguments, container="webm", memory_bytes=needed[0])
    with pytest.raises(pvg.TooLargeError):
        draw_part(arguments, container="mp4", memory_bytes=needed[1] - 1)
