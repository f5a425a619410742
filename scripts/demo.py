"""`make demo`: a real clip recoloured from two real portraits, all through the HTTP service on its embedded default."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import httpx
import numpy as np
from numpy.typing import NDArray

from pvg.video import probe, read_frames, write_image
from scripts.samples import REPOSITORY, fetch_samples

OUTPUT = REPOSITORY / "demo"
_TILE_HEIGHT = 300
_START_TIMEOUT_S = 60.0
_JOB_TIMEOUT_S = 600.0


def _free_port() -> int:
    with socket.socket() as probe_socket:
        probe_socket.bind(("127.0.0.1", 0))
        return int(probe_socket.getsockname()[1])


@contextmanager
def running_service(data_dir: Path) -> Iterator[httpx.Client]:
    """`pvg-service serve` on a free port, stopped by the same signal as Ctrl-C."""
    port = _free_port()
    environment = {**os.environ, "PVG_DATA_DIR": str(data_dir), "PVG_PORT": str(port)}
    command = [str(Path(sys.executable).with_name("pvg-service")), "serve"]
    with (data_dir / "service.log").open("wb") as log:
        service = subprocess.Popen(command, env=environment, stdout=log, stderr=log, start_new_session=True)
        try:
            with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60) as client:
                _wait_ready(client, service, data_dir / "service.log")
                yield client
        finally:
            service.send_signal(signal.SIGINT)
            service.wait(timeout=60)


def _wait_ready(client: httpx.Client, service: subprocess.Popen[bytes], log: Path) -> None:
    deadline = time.monotonic() + _START_TIMEOUT_S
    while time.monotonic() < deadline:
        if service.poll() is not None:
            sys.exit(f"the service stopped at once:\n{log.read_text()}")
        try:
            if client.get("/readyz").status_code == httpx.codes.OK:
                return
        except httpx.TransportError:
            pass
        time.sleep(0.2)
    sys.exit(f"the service was not ready after {_START_TIMEOUT_S:.0f} s:\n{log.read_text()}")


def _upload(client: httpx.Client, path: str, file: Path) -> dict[str, Any]:
    with file.open("rb") as data:
        answer = client.post(path, files={"file": (file.name, data)})
    answer.raise_for_status()
    body: dict[str, Any] = answer.json()
    return body


def _finished(client: httpx.Client, job: str, what: str) -> dict[str, Any]:
    deadline = time.monotonic() + _JOB_TIMEOUT_S
    while time.monotonic() < deadline:
        body: dict[str, Any] = client.get(f"/jobs/{job}", params={"wait": 2}).raise_for_status().json()
        if sys.stderr.isatty():
            print(f"\r{what}: {body['progress']['fraction'] or 0:4.0%}", end="", file=sys.stderr)
        if body["done"]:
            if sys.stderr.isatty():
                print(file=sys.stderr)
            if body["state"] != "succeeded":
                sys.exit(f"{what} {body['state']}: {body['error']}")
            return body
    sys.exit(f"{what} took more than {_JOB_TIMEOUT_S:.0f} s")


def contact_sheet(rows: list[tuple[str, Path]], target: Path) -> None:
    """First, middle and last frame of each clip, a row a clip, named at the left edge."""
    lines = []
    for name, clip in rows:
        count = sum(1 for _ in read_frames(clip))
        wanted = {0, count // 2, count - 1}
        tiles = [_tile(frame.rgb()) for frame in read_frames(clip) if frame.index in wanted]
        line = np.concatenate(tiles, axis=1)
        cv2.putText(line, name, (8, 22), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (0, 0, 0), 4, cv2.LINE_AA)
        cv2.putText(line, name, (8, 22), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (255, 255, 255), 1, cv2.LINE_AA)
        lines.append(line)
    write_image(target, np.concatenate(lines, axis=0))


def _tile(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    width = round(rgb.shape[1] * _TILE_HEIGHT / rgb.shape[0])
    return np.asarray(cv2.resize(rgb, (width, _TILE_HEIGHT), interpolation=cv2.INTER_AREA), np.uint8)


def main() -> None:
    """Run the demo."""
    samples = fetch_samples()
    looks = {"look-1": samples.dark_portrait, "look-2": samples.pale_portrait}
    OUTPUT.mkdir(exist_ok=True)
    started = time.monotonic()
    with (
        tempfile.TemporaryDirectory(prefix="pvg-demo-") as data_dir,
        running_service(Path(data_dir)) as client,
    ):
        print(f"service: {client.base_url}")
        video = _upload(client, "/videos", samples.woman_clip)
        print(f"uploaded {samples.woman_clip.name} as {video['id']}")
        vectorized = _finished(client, video["job"], "vectorise")
        references = [_upload(client, "/references", portrait)["id"] for portrait in looks.values()]
        request = {"video": video["id"], "looks": [{"reference": reference} for reference in references]}
        accepted = client.post("/transfer", json=request).raise_for_status().json()
        job = _finished(client, accepted["id"], "transfer")
        for name, look in zip(looks, job["looks"], strict=True):
            answer = client.get(f"/results/{look['result']}").raise_for_status()
            (OUTPUT / f"{name}.mp4").write_bytes(answer.content)
        print(f"vectorised once: {vectorized['timings']}")
        print(f"two looks: {job['timings']}")
    rows = [("source", samples.woman_clip), *((name, OUTPUT / f"{name}.mp4") for name in looks)]
    contact_sheet(rows, OUTPUT / "contact-sheet.png")
    info = probe(OUTPUT / "look-1.mp4")
    print(f"{info.width}x{info.height}, {info.frame_count} frames, in {time.monotonic() - started:.0f} s:")
    for path in sorted(OUTPUT.glob("look-*.mp4")):
        print(f"  {path.relative_to(REPOSITORY)}")
    print(f"  {(OUTPUT / 'contact-sheet.png').relative_to(REPOSITORY)}")


if __name__ == "__main__":
    main()
