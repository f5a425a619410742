"""What is fuzzed: what takes bytes, small honest seeds for it, and the errors that are its answer to bad ones."""

from __future__ import annotations

import asyncio
import hashlib
import io
import json
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random

from starlette.requests import Request
from starlette.types import Message

from pvg.asset import open_asset
from pvg.errors import AssetError, MediaError
from pvg.video import probe, read_picture_metadata, write_image
from pvg.video.metadata_record import PictureMetadata
from pvg.video.sniffing import IMAGE_KINDS, sniff
from service.api import sniffing
from service.api.multipart import read_form
from service.api.ranges import matches, parse_range
from service.api.uploads import Intake
from service.errors import ServiceError
from service.queue import make_folders
from service.room import Room
from service.settings import Settings
from service.spool import Spool
from service.storage import Storage
from tests.fuzz.mutations import mutated
from tests.gallery import hostile
from tests.gallery.assets import write_asset
from tests.gallery.pictures import colorful
from tests.gallery.profiles import P3, profile, srgb_curve

Mutation = Callable[[bytes, Random], bytes]


@dataclass(frozen=True)
class Target:
    """do: takes the bytes of a case. expected: errors that are an answer; any other, and a dead process, is a find."""

    name: str
    do: Callable[[bytes], object]
    seeds: Sequence[bytes]
    expected: tuple[type[Exception], ...]
    mutation: Mutation = mutated


def media(folder: Path) -> Target:
    """Sniffing, probing (which decodes the first picture) and what pictures carry."""
    clips = ("a.mp4", "a.mov", "a.mkv", "a.avi")
    seeds = [hostile.honest_clip(folder / name) for name in clips]
    seeds.append(hostile.honest_clip(folder / "fragments.mp4", movflags="frag_keyframe+empty_moov+default_base_moof"))
    exif = b"II*\0\x08\0\0\0\x01\0\x0e\x01\x02\0\x06\0\0\0\x1a\0\0\0\0\0\0\0hello\0"
    for name in ("a.jpg", "a.png", "a.webp", "a.tif"):
        metadata = PictureMetadata(icc=profile(P3, srgb_curve()), exif=exif)
        write_image(folder / name, colorful(3), metadata=metadata)
        seeds.append((folder / name).read_bytes())
    path = folder / "case"

    def do(data: bytes) -> None:
        sniffing.sniff(data[: sniffing.HEAD_BYTES])
        path.write_bytes(data)
        if sniff(path) in IMAGE_KINDS:
            read_picture_metadata(path)
        probe(path)

    return Target("media", do, seeds, (MediaError,))


def asset(folder: Path) -> Target:
    """Opening an asset and reading every array of it; half of the cases have digests that fit what was changed."""
    (folder / "clip").write_bytes(b"any clip")
    seed = write_asset(folder / "seed.pvg", folder / "clip").read_bytes()
    path = folder / "case.pvg"

    def do(data: bytes) -> None:
        path.write_bytes(data)
        with open_asset(path, find_source=False) as video:
            for face in (record.summary for record in video.records):
                video.landmarks(face.index)
                for frame in range(face.first_frame, min(face.last_frame, face.first_frame + 20) + 1):
                    video.face_at(face.index, frame)

    def mutation(data: bytes, rng: Random) -> bytes:
        return sealed(data, rng) if rng.random() < 0.7 else mutated(data, rng)

    return Target("asset", do, [seed], (AssetError,), mutation)


def sealed(data: bytes, rng: Random) -> bytes:
    """An asset one of whose entries was changed by somebody who knows how digests are made."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    manifest = json.loads(entries.pop("manifest.json"))
    name = rng.choice(["manifest.json", *entries])
    if name in entries:
        entries[name] = mutated(entries[name], rng)
        manifest["entries"][name] = hashlib.sha256(entries[name]).hexdigest()
    text = json.dumps(manifest).encode()
    if name == "manifest.json":
        text = mutated(text, rng)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for entry, body in entries.items():
            archive.writestr(entry, body)
        archive.writestr("manifest.json", text)
        archive.comment = hashlib.sha256(text).hexdigest().encode()
    return out.getvalue()


_FORM = (
    b'--edge\r\nContent-Disposition: form-data; name="strength"\r\n\r\n0.5\r\n'
    b'--edge\r\nContent-Disposition: form-data; name="file"; filename="a.png"\r\nContent-Type: image/png\r\n\r\n'
    b"\x89PNG\r\n\x1a\n" + bytes(64) + b"\r\n--edge--\r\n"
)
_FORM_HEAD = b"multipart/form-data; boundary=edge\n"


def forms(folder: Path) -> Target:
    """A multipart body in pieces; the first line of a case is its content type."""
    make_folders(settings := Settings(data_dir=folder))
    spool, room = Storage(settings).spool, Room(settings)

    def do(data: bytes) -> None:
        asyncio.run(_received(spool, room, data))
        left = [path for path in folder.rglob("*") if path.is_file()]
        if left:
            raise AssertionError(f"left behind: {left}")

    return Target("forms", do, [_FORM_HEAD + _FORM, _FORM_HEAD + _FORM.replace(b"edge", b"x" * 4)], (ServiceError,))


async def _received(spool: Spool, room: Room, data: bytes) -> None:
    content_type, _, body = data.partition(b"\n")
    step = 1 + len(body) % 97
    pieces = [body[k : k + step] for k in range(0, len(body), step)] or [b""]

    async def receive() -> Message:
        piece = pieces.pop(0)
        return {"type": "http.request", "body": piece, "more_body": bool(pieces)}

    scope = {"type": "http", "method": "POST", "headers": [(b"content-type", content_type)]}
    async with Intake(spool, room, Request(scope, receive), limit_bytes=10_000) as intake:
        await read_form(intake, max_files=2)


def ranges(folder: Path) -> Target:
    """Range and conditional headers; the first byte of a case is the size of the file."""

    def do(data: bytes) -> None:
        size, header = data[0] if data else 0, data[1:].decode("latin-1")
        matches(header, '"tag"')
        matches(header, '"tag"', weak=False)
        found = parse_range(header, size)
        if found is not None and not 0 <= found[0] < found[1] <= size:
            raise AssertionError(f"{found} of {size} bytes")

    seeds = [b"\x64bytes=0-99", b"\x0abytes=-5", b"\xffbytes=7-", b'\x40W/"tag", "other"', b"\0bytes=0-0,5-9"]
    return Target("ranges", do, seeds, (ServiceError,))


MAKERS: dict[str, Callable[[Path], Target]] = {"media": media, "asset": asset, "forms": forms, "ranges": ranges}


def seeded(target: Target, seed: int, number: int) -> bytes:
    """The case of a number: the same for the same seed, on every machine with the same encoders."""
    rng = Random(f"{seed} {target.name} {number}")
    return target.mutation(rng.choice(target.seeds), rng)
