"""Fixtures of the asset's tests: an asset of made-up arrays and the file it says it was made from."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.gallery.assets import write_asset


@pytest.fixture
def source(tmp_path: Path) -> Path:
    path = tmp_path / "clip.bin"
    path.write_bytes(b"the clip")
    return path


@pytest.fixture
def asset(tmp_path: Path, source: Path) -> Path:
    return write_asset(tmp_path / "clip.pvg", source)
