"""Files that mean harm, uploaded to the whole service, which is watched from outside: R14."""

from __future__ import annotations

import re
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import pytest

from scripts.samples import Samples
from tests.gallery import hostile
from tests.gallery.pictures import colorful
from tests.promises import Drill
from tests.service.remote import PRIVATE, remote
from tests.service.servers import installed
from tests.worker.serving import parent_of, running_service, worker_processes

#: what a job may end with that such a file is given to: it is the file's fault, and the text says which
CLEAR = {"media-invalid", "too-long", "too-large", "no-face", "time-limit"}
REFUSED = {400, 413, 415, 422}


def in_box(data: bytes, path: tuple[bytes, ...], new: bytes) -> bytes:
    """An MP4 whose box at this path is another one; boxes around it grow with it, and the media lie before them."""
    starts = []
    at = 0
    for kind in path:
        at = data.index(kind, at) - 4
        starts.append(at)
        at += 8
    last = starts[-1]
    size = int.from_bytes(data[last : last + 4], "big")
    grown = bytearray(data[:last] + new + data[last + size :])
    for start in starts[:-1]:
        grown[start : start + 4] = (int.from_bytes(data[start : start + 4], "big") + len(new) - size).to_bytes(4, "big")
    return bytes(grown)


def pointing(folder: Path, file: Path, url: str) -> Iterator[tuple[str, bytes]]:
    """Files that name another file, or an address, for a reader to open."""
    mp4, mov = (hostile.honest_clip(folder / f"honest.{suffix}") for suffix in ("mp4", "mov"))
    track = (b"moov", b"trak", b"mdia", b"minf", b"dinf", b"dref", b"url ")
    for name, at in (("file", f"file://{file}"), ("http", f"{url}clip.mp4")):
        yield f"data at {name}.mp4", in_box(mp4, track, hostile.box(b"url ", bytes(4) + at.encode() + b"\0"))
        yield f"playlist of {name}.mp4", f"#EXTM3U\n#EXTINF:1,\n{at}\n#EXT-X-ENDLIST\n".encode()
        yield f"script of {name}.mov", f"ffconcat version 1.0\nfile '{at}'\n".encode()
        yield f"drawing of {name}.jpg", f'<svg xmlns="http://www.w3.org/2000/svg"><image href="{at}"/></svg>'.encode()
        yield f"first a box, then a list of {name}.mp4", mp4[:32] + f"\n#EXTM3U\n#EXTINF:1,\n{at}\n".encode()
        reference = hostile.box(b"rdrf", bytes(4) + b"url " + len(at).to_bytes(4, "big") + at.encode())
        movie = hostile.box(b"moov", hostile.box(b"rmra", hostile.box(b"rmda", reference)))
        yield f"movie that is at {name}.mov", hostile.box(b"ftyp", b"qt  \0\0\0\0qt  ") + movie
    relative = f"../../../../../../../..{file}"
    alias = bytes(4) + bytes(150) + b"\0\x02" + len(relative).to_bytes(2, "big") + relative.encode() + b"\xff\xff\0\0"
    yield "alias.mov", in_box(mov, track, hostile.box(b"alis", alias))
    yield "description.mp4", f"v=0\r\nc=IN IP4 {PRIVATE}\r\nm=video 9 RTP/AVP 96\r\n".encode()
    yield "manifest.mp4", f'<?xml version="1.0"?><MPD><BaseURL>{url}</BaseURL></MPD>'.encode()
    entity = f'<!DOCTYPE a [<!ENTITY b SYSTEM "file://{file}">]><a>&b;</a>'
    yield "entity.png", f'<?xml version="1.0"?>{entity}'.encode()
    for number, name in enumerate((str(file), relative, f"concat:{file}", f"{url}a.mp4", "a%00%s.mp4", "-i.mp4")):
        yield name, mp4 + hostile.box(b"free", bytes([number]))  # an honest clip but for its name


def boundless(folder: Path) -> Iterator[tuple[str, bytes]]:
    """Files that claim, or would become, far more than they are; and what is no medium at all."""
    for make in (*hostile.CLIPS, *hostile.PICTURES):
        path = make(folder)
        yield path.name, path.read_bytes()
    packed = folder / "zeros.zip"
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("zeros", bytes(2**26))
    yield "zeros.mp4", packed.read_bytes()
    yield "empty.mp4", b""
    picture = cv2.imencode(".png", colorful(3))[1].tobytes()
    head = b"IHDR" + bytes([0, 0, 255, 255]) * 2 + picture[24:29]
    yield "65535x65535.png", picture[:12] + head + zlib.crc32(head).to_bytes(4, "big") + picture[33:]
    whole = hostile.honest_clip(folder / "whole.mp4")
    yield "cut.mp4", whole[: len(whole) // 2]
    yield "noise.mp4", whole[:200] + bytes(range(256)) * 40


@pytest.mark.slow
def test_hostile_files_read_nothing_reach_nobody_and_the_worker_lives(
    tmp_path: Path, samples: Samples, promise: Callable[..., Drill]
) -> None:
    drill = promise("R14", wanted="uploaded: no outside access, no file read, clear error, worker lives")
    strace = installed("strace")
    secret, calls, folder = tmp_path / "nobodys-business", tmp_path / "calls", tmp_path / "hostile"
    secret.write_text("nothing that a job may see")
    folder.mkdir()
    seen = "connect,sendto,sendmsg,sendmmsg,open,openat,openat2,stat,newfstatat,statx,readlink,execve"
    before = (strace, "-D", "-f", "--seccomp-bpf", "-qq", "-s", "400", "-e", f"trace={seen}", "-o", str(calls))
    with (
        remote(PRIVATE) as inside,
        running_service(tmp_path, before=before, worker_concurrency="2", job_soft_limit_s="120") as service,
    ):
        files = [*pointing(folder, secret, f"http://{PRIVATE}:{inside.port}/"), *boundless(folder)]
        workers = worker_processes(service.data_dir, 3)
        (main,) = [pid for pid in workers if parent_of(pid) not in workers]
        refused: Counter[int] = Counter()
        jobs: dict[str, str] = {}
        for name, content in files:
            answer = service.client.post("/videos", files={"file": (name, content)})
            if answer.status_code == 202:
                jobs[answer.json()["job"]] = name
            else:
                problem = answer.json()
                refused[answer.status_code] += 1
                assert answer.status_code in REFUSED, (name, problem)
                assert problem["detail"], name
        ended = {name: service.finished(job) for job, name in jobs.items()}
        # and the next job runs, with the same worker
        after = service.ready("/references", samples.portrait)
        left = worker_processes(service.data_dir, 3)
        log = service.log.read_text()
    codes = Counter(job["error"]["code"] for job in ended.values())
    lines = calls.read_text(errors="replace").splitlines()
    outside = [line for line in lines if re.search(r"connect\(.*sa_family=AF_(?!UNIX)", line)]
    looks = re.compile(r"\b(open\w*|\w*stat\w*|readlink|execve)\(")
    touched = [line for line in lines if secret.name in line and looks.search(line)]
    drill.measured = (
        f"{len(files)} files: {sum(refused.values())} refused at once, {dict(codes)}; {inside.connections} connections "
        f"inside, {len(outside)} to an address, {len(touched)} looks at the file they name; the next job "
        f"{after['state']}"
    )
    assert len(files) >= 40
    assert len(ended) >= 25
    assert codes.keys() <= CLEAR, {name: job["error"] for name, job in ended.items()}
    assert all(job["error"]["detail"] and "\n" not in job["error"]["detail"] for job in ended.values())
    assert {job["attempt"] for job in ended.values()} == {1}
    assert any("openat(" in line and "spool/" in line for line in lines)  # what they do is seen
    assert (inside.connections, outside, touched) == (0, [], [])
    assert main in left
    assert "the worker ended by itself" not in log
    assert after["state"] == "ready"
