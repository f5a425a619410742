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

import cv2
import httpx
import numpy as np
from numpy.typing import NDArray

from pvg.video import probe, read_frames, write_image
from pvg_client import Client, Look, PvgClientError
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
def running_service(data_dir: Path) -> Iterator[str]:
    """`pvg-service serve` on a free port, stopped by the same signal as Ctrl-C; its address."""
    port = _free_port()
    environment = {**os.environ, "PVG_DATA_DIR": str(data_dir), "PVG_PORT": str(port)}
    command = [str(Path(sys.executable).with_name("pvg-service")), "serve"]
    with (data_dir / "service.log").open("wb") as log:
        service = subprocess.Popen(command, env=environment, stdout=log, stderr=log, start_new_session=True)
        try:
            url = f"http://127.0.0.1:{port}"
            _wait_ready(url, service, data_dir / "service.log")
            yield url
        finally:
            service.send_signal(signal.SIGINT)
            service.wait(timeout=60)


def _wait_ready(url: str, service: subprocess.Popen[bytes], log: Path) -> None:
    deadline = time.monotonic() + _START_TIMEOUT_S
    while time.monotonic() < deadline:
        if service.poll() is not None:
            sys.exit(f"the service stopped at once:\n{log.read_text()}")
        try:
            if httpx.get(f"{url}/readyz").status_code == httpx.codes.OK:
                return
        except httpx.TransportError:
            pass
        time.sleep(0.2)
    sys.exit(f"the service was not ready after {_START_TIMEOUT_S:.0f} s:\n{log.read_text()}")


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
        running_service(Path(data_dir)) as url,
        Client(url) as client,
    ):
        print(f"service: {url}")
        video = client.upload(samples.woman_clip)
        print(f"uploaded {samples.woman_clip.name} as {video.id}")
        vectorized = client.wait(video, timeout=_JOB_TIMEOUT_S)
        references = [client.upload(portrait, role="reference") for portrait in looks.values()]
        transfer = client.transfer(video, [Look(reference) for reference in references])
        job = client.wait(transfer, timeout=_JOB_TIMEOUT_S)
        for name, result in zip(looks, job.results, strict=True):
            client.download(result, OUTPUT / f"{name}.mp4")
        print(f"vectorised once: {vectorized.timings}")
        print(f"two looks: {job.timings}")
    rows = [("source", samples.woman_clip), *((name, OUTPUT / f"{name}.mp4") for name in looks)]
    contact_sheet(rows, OUTPUT / "contact-sheet.png")
    info = probe(OUTPUT / "look-1.mp4")
    print(f"{info.width}x{info.height}, {info.frame_count} frames, in {time.monotonic() - started:.0f} s:")
    for path in sorted(OUTPUT.glob("look-*.mp4")):
        print(f"  {path.relative_to(REPOSITORY)}")
    print(f"  {(OUTPUT / 'contact-sheet.png').relative_to(REPOSITORY)}")


if __name__ == "__main__":
    try:
        main()
    except (PvgClientError, TimeoutError) as error:
        sys.exit(str(error))
