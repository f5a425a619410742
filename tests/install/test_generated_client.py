"""A client that openapi-python-client makes of the schema, installed and used by itself."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from pvg.video import probe
from scripts.samples import Samples
from tests.install.environments import bare_environment, succeeds
from tests.worker.serving import running_service

MAIN_PATH = Path(__file__).with_name("generated_client.py")
#: files of these types are bytes to it, as docs/api.md says
FILES = ("video/mp4", "video/quicktime", "video/x-matroska", "video/webm")
PICTURES = ("image/png", "image/jpeg", "image/webp", "image/tiff")
#: a piece of a file
PIECE = "application/offset+octet-stream"
pytestmark = pytest.mark.timeout(1800)


def test_a_generated_client_does_the_main_path(tmp_path: Path, samples: Samples) -> None:
    generator = bare_environment(tmp_path / "generator", sys.executable)
    generator.install("openapi-python-client>=0.25")
    user = bare_environment(tmp_path / "user", sys.executable)
    config = tmp_path / "config.json"  # JSON is YAML
    overrides = dict.fromkeys((*FILES, *PICTURES, PIECE), "application/octet-stream")
    config.write_text(
        json.dumps({"project_name_override": "pvg-generated", "content_type_overrides": overrides, "post_hooks": []})
    )
    with running_service(tmp_path) as service:
        schema = tmp_path / "openapi.json"
        schema.write_bytes(service.client.get("/openapi.json").content)
        project = tmp_path / "project"
        said = succeeds(
            *(generator.command("openapi-python-client"), "generate", "--path", schema, "--config", config),
            *("--output-path", project, "--meta", "setup", "--fail-on-warning"),
        )
        assert "WARNING" not in said
        user.install(project)
        result = tmp_path / "result.png"
        address = str(service.client.base_url).rstrip("/")
        media = (samples.portrait, samples.dark_portrait)
        assert succeeds(user.python, MAIN_PATH, address, *media, result).endswith("done\n")
    assert probe(result).width == probe(samples.portrait).width
