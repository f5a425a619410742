"""Where the clip of an asset lies: noted relative to the asset, so that both may be moved together.

What is noted is a hint and nothing more. Whoever wrote the file may have named any path there, so the clip counts as
the right one only by its sha256 (`VectorVideo.require_source`), and who knows the clip says so and follows no hint.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

__all__ = ["find_source", "source_note"]


def source_note(source: Path, asset: Path | None) -> dict[str, str]:
    """The manifest's fields: the clip's name and, with slashes, its path from the folder of the asset file.

    asset: None for a temporary one, which notes the name alone; nor is there a path to another drive.
    """
    note = {"source_name": source.name}
    if asset is not None:
        try:
            relative = os.path.relpath(source.resolve(), asset.resolve().parent)
        except ValueError:
            return note
        note["source_path"] = relative.replace(os.sep, "/")
    return note


def find_source(asset: Path, manifest: Mapping[str, Any]) -> Path | None:
    """The clip that the manifest of the file `asset` points to: at the noted path, else beside it by its name.

    None where neither is a regular file. Absolute paths and names with folders in them are not followed.
    """
    folder = asset.resolve().parent
    path, name = manifest.get("source_path"), manifest.get("source_name")
    candidates = []
    if isinstance(path, str) and _is_relative(path):
        candidates.append(folder / path)
    if isinstance(name, str) and name == PurePosixPath(name).name and _is_relative(name):
        candidates.append(folder / name)
    return next((found for found in candidates if _is_file(found)), None)


def _is_relative(path: str) -> bool:
    windows = PureWindowsPath(path)
    return bool(path) and not (PurePosixPath(path).is_absolute() or windows.drive or windows.root)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # too long, or with a zero byte
        return False
