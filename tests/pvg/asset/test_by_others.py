"""Assets made by others: an error that says so, at once and in little memory, or an asset like any other."""

from __future__ import annotations

import bz2
import hashlib
import json
import random
import time
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pvg.asset import open_asset
from pvg.asset.arrays import CHUNK_FRAMES, encode, to_bytes
from pvg.errors import AssetError
from pvg.face import layout
from tests.gallery.assets import FIRST, FRAMES

#: what reading the whole made-up asset takes at most, and so what an altered one may
MEMORY_BYTES, SECONDS = 40 * 1024**2, 20.0
BOMB_BYTES = 80 * 1024**2 + 4711  # more than any entry may have, and no common bytes


def read_all(path: Path) -> None:
    with open_asset(path) as video:
        video.verify()
        json.dumps(video.summary())
        assert video.persons
        for record in video.records:
            face = record.summary
            video.landmarks(face.index)
            for frame in {face.first_frame, face.last_frame, FIRST, FIRST + FRAMES - 1}:
                video.face_at(face.index, frame)


def parts_of(asset: Path) -> tuple[dict[str, Any], dict[str, bytes]]:
    with zipfile.ZipFile(asset) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    return json.loads(entries.pop("manifest.json")), entries


def write(path: Path, manifest: object, entries: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> Path:
    """An asset whose digests all fit, as whoever makes one on purpose writes it."""
    if isinstance(manifest, dict) and isinstance(manifest.get("entries"), dict):
        manifest["entries"] |= {name: hashlib.sha256(data).hexdigest() for name, data in entries.items()}
    data = manifest if isinstance(manifest, bytes) else json.dumps(manifest).encode()
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
        archive.writestr("manifest.json", data)
        archive.comment = hashlib.sha256(data).hexdigest().encode()
    return path


def bounded(path: Path) -> str | None:
    """Read it; what the error says, None when there is none."""
    tracemalloc.start()
    began = time.thread_time()
    try:
        read_all(path)
        said = None
    except AssetError as error:
        said = str(error)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < MEMORY_BYTES
    assert time.thread_time() - began < SECONDS
    return said


ODD: list[Any] = [None, True, -1, 0, 10**18, 10**400, 1.5, float("nan"), float("inf"), "x", "", [], [[]], {}, {"a": []}]


def test_odd_values_in_a_manifest_are_refused_or_harmless(asset: Path, tmp_path: Path) -> None:
    """Every value of the manifest in turn is one of a list of odd ones, removed, or of another kind."""
    good, entries = parts_of(asset)
    places: list[tuple[Any, ...]] = []

    def walk(value: Any, at: tuple[Any, ...]) -> None:
        inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        for key, one in inner:
            if at != ("entries",) or key.endswith(("score/000000", "colors")):
                places.append((*at, key))
                walk(one, (*at, key))

    walk(good, ())
    rng = random.Random(7)
    said = []
    for place in places:
        for odd in rng.sample(ODD, 2):
            manifest = json.loads(json.dumps(good))
            target = manifest
            for key in place[:-1]:
                target = target[key]
            target[place[-1]] = odd
            path = tmp_path / "odd.pvg"
            data = json.dumps(manifest).encode()
            with zipfile.ZipFile(path, "w") as archive:  # stored: quicker
                for name, content in entries.items():
                    archive.writestr(name, content)
                archive.writestr("manifest.json", data)
                archive.comment = hashlib.sha256(data).hexdigest().encode()
            try:
                read_all(path)
            except AssetError as error:
                said.append(str(error))
    assert len(said) > len(places)


def forged(dtype: str, shape: list[int], planes: tuple[int, ...], data: bytes) -> bytes:
    """An entry whose type, shape and header say what they like."""
    header = f"{{'descr': '|u1', 'fortran_order': False, 'shape': {planes}, }}".ljust(117).encode() + b"\n"
    start = json.dumps({"dtype": dtype, "shape": shape}).encode() + b"\n"
    return start + b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + data


HUGE, SIDE = 10**12, 320


def places(at: float, count: int = layout.LANDMARK_COUNT) -> np.ndarray:
    """A chunk as it is stored, of faces whose points all lie `at` the same x and y, pixels."""
    return encode("points", np.full((CHUNK_FRAMES, count, 2), at, np.float32))


ENTRIES: dict[str, tuple[str, Callable[[bytes], bytes]]] = {
    "an array of a terabyte": ("score/000000", lambda _: forged("<f4", [32, HUGE], (4, 32 * HUGE), b"")),
    "a shape of a terabyte": ("score/000000", lambda _: forged("<f4", [HUGE], (4, 32), bytes(128))),
    "a negative side": ("score/000000", lambda _: forged("<f4", [-1, 1], (4, 32), bytes(128))),
    "objects": ("score/000000", lambda _: forged("|O", [4], (8, 4), bytes(32))),
    "nothing": ("points/000000", lambda _: b""),
    "a line": ("points/000000", lambda _: b"{}\n"),
    "deep nesting": ("points/000000", lambda _: b"[" * 20_000),
    "no numbers": ("score/000000", lambda _: to_bytes(np.full((32, 1), np.nan, np.float32))),
    "too few rows": ("score/000000", lambda _: to_bytes(np.zeros((31, 1), np.float32))),
    "another type": ("score/000000", lambda _: to_bytes(np.zeros((32, 1), np.int32))),
    "places beyond the moon": ("box/000000", lambda _: to_bytes(np.full((32, 4), 2**31 - 1, np.int32))),
    "a face of ten pictures": ("points/000000", lambda _: to_bytes(places(10 * SIDE))),
    "a face far to the left": ("skin_points/000000", lambda _: to_bytes(places(-9 * SIDE, layout.SKIN_COUNT))),
    "a box of no width": ("box/000000", lambda _: to_bytes(encode("box", np.full((32, 4), 50.0, np.float32)))),
    "a box of no height": (
        "box/000000",
        lambda _: to_bytes(encode("box", np.tile(np.array([50, 60, 90, 60], np.float32), (32, 1)))),
    ),
    "a matte without cells": ("matte/000000", lambda _: to_bytes(np.zeros((32, 0, 5), np.uint8))),
    "samples that there are not": ("skin_at/000000", lambda _: to_bytes(np.full(64, 30_000, np.int16))),
    "key frames that there are not": ("colors", lambda _: to_bytes(np.zeros((9, 694, 3), np.float32))),
}


@pytest.mark.parametrize("what", ENTRIES)
def test_an_entry_is_what_it_must_be(asset: Path, tmp_path: Path, what: str) -> None:
    manifest, entries = parts_of(asset)
    name, change = ENTRIES[what]
    entries[f"track0/{name}"] = change(entries[f"track0/{name}"])
    said = bounded(write(tmp_path / "asset.pvg", manifest, entries))
    assert said is not None
    assert f"track0/{name}" in said


def test_a_face_that_overfills_the_picture_is_read(asset: Path, tmp_path: Path) -> None:
    manifest, entries = parts_of(asset)
    entries["track0/points/000000"] = to_bytes(places(6 * SIDE))
    assert bounded(write(tmp_path / "asset.pvg", manifest, entries)) is None


@pytest.mark.parametrize("method", [zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2])
@pytest.mark.parametrize("honest", [True, False])
def test_what_inflates_without_end_is_stopped(asset: Path, tmp_path: Path, method: int, honest: bool) -> None:
    """Many zeros in some kilobytes, whether the entry says so or names the size of what belongs there."""
    manifest, entries = parts_of(asset)
    name = "track0/matte/000000"
    size = len(entries[name])
    entries[name] = bytes(BOMB_BYTES)
    path = write(tmp_path / "bomb.pvg", manifest, entries, method)
    assert path.stat().st_size < 1024**2
    if not honest:
        body = path.read_bytes()
        said = BOMB_BYTES.to_bytes(4, "little")
        assert body.count(said) >= 2  # in the entry's own head and in the directory
        path.write_bytes(body.replace(said, size.to_bytes(4, "little")))
    del entries
    assert bounded(path) is not None


def test_a_bomb_of_many_streams_is_stopped(asset: Path, tmp_path: Path) -> None:
    """zipfile inflates all of a piece of bzip2 at once, whatever size it is to have."""
    manifest, entries = parts_of(asset)
    path = write(tmp_path / "bomb.pvg", manifest, entries, zipfile.ZIP_BZIP2)
    with zipfile.ZipFile(path) as archive:
        info = archive.getinfo("track0/matte/000000")
    bomb = bz2.compress(bytes(BOMB_BYTES))
    body = bytearray(path.read_bytes())
    start = info.header_offset + 30 + len(info.filename)
    assert len(bomb) <= info.compress_size, "the bomb takes the place of the entry"
    body[start : start + len(bomb)] = bomb
    path.write_bytes(body)
    assert bounded(path) is not None


@pytest.mark.parametrize(
    "manifest", [b"", b"[" * 100_000, b"[]", b"1e400", b"{}", b'{"format": 3}', b"\xff\xfe", b'{"a":' * 50_000]
)
def test_a_manifest_that_is_none_is_refused(tmp_path: Path, manifest: bytes) -> None:
    assert bounded(write(tmp_path / "asset.pvg", manifest, {})) is not None


def test_a_directory_without_end_is_refused(asset: Path, tmp_path: Path) -> None:
    body = asset.read_bytes()
    record = body[body.index(b"PK\x01\x02") :][:60]
    end = body.rindex(b"PK\x05\x06")
    directory = record * (40 * 1024**2 // len(record))
    tail = bytearray(body[end:])
    tail[12:20] = len(directory).to_bytes(4, "little") + (0).to_bytes(4, "little")
    path = tmp_path / "asset.pvg"
    path.write_bytes(directory + bytes(tail))
    assert bounded(path) is not None


def test_altered_bytes_with_fitting_digests_are_refused_or_read(asset: Path, tmp_path: Path) -> None:
    """A fixed list of mutations of the arrays, with digests that fit."""
    rng = random.Random(11)
    manifest, entries = parts_of(asset)
    names = sorted(entries)
    outcomes = {"read": 0, "refused": 0}
    for _ in range(60):
        changed = dict(entries)
        name = rng.choice(names)
        data = bytearray(entries[name])
        for _ in range(rng.choice((1, 1, 4, 40))):
            at = rng.randrange(min(len(data), rng.choice((40, 200, len(data)))))
            data[at] = rng.randrange(256)
        changed[name] = bytes(data[: rng.choice((len(data), len(data), rng.randrange(len(data))))])
        path = write(tmp_path / "asset.pvg", json.loads(json.dumps(manifest)), changed, zipfile.ZIP_STORED)
        try:
            read_all(path)
        except AssetError:
            outcomes["refused"] += 1
        else:
            outcomes["read"] += 1
    assert min(outcomes.values()) > 0, outcomes
