"""The real service for the client's tests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from pvg_client import Client
from scripts.samples import Samples
from tests.conftest import cut_clip
from tests.worker.serving import Service, running_service


@pytest.fixture(scope="package")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    with running_service(tmp_path_factory.mktemp("client")) as running:
        yield running


@pytest.fixture(scope="package")
def url(service: Service) -> str:
    return str(service.client.base_url)


@pytest.fixture
def client(url: str) -> Iterator[Client]:
    with Client(url, retries=3) as made:
        yield made


@pytest.fixture(scope="package")
def clip(samples: Samples, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """12 frames of a woman, 640x360, under a name that is not ASCII."""
    return cut_clip(samples.woman_clip, tmp_path_factory.mktemp("clip") / "frau lächelt.mp4", 20, 32)
