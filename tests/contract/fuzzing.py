"""`python -m tests.contract.fuzzing`: schemathesis with all its checks against a running service.

Cases come from the schema alone: what it allows, what it just does not, methods that are not there, keys that are
missing. No answer may be 5xx, or one that the schema does not tell of, or not be as it says.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

from pydantic import SecretStr

from service.api.routers import events
from service.catalog import keys
from service.settings import Settings
from tests.service.api.test_previews import preview_worker
from tests.service.fixtures import MP4, Api, make_ready, make_results, serve

FOLDER = Path(__file__).parent
#: the schema cannot tell that fields fit each other, such as a codec and its container, which names there are on the
#: internet, that a name of metadata is given once, or what base64 and JSON in a string say: 422 is an answer to them
BETWEEN_FIELDS = (
    *("create_transfer", "create_transfer_from_form", "create_swap", "create_preview", "create_upload_link"),
    *("create_video", "create_video_from_form", "create_video_from_url", "create_upload"),
    *("create_reference", "create_reference_from_form", "create_reference_from_url"),
    *("append_to_upload", "list_jobs", "list_videos", "list_references"),
)
#: any If-Match is as it should be, and few are the ETag of what is there
CONDITIONAL = (
    *("get_video_file", "get_reference_file", "get_result", "get_result_cube", "get_result_matte"),
    *("delete_video", "delete_reference", "delete_result", "delete_job"),
)
ACCEPTED = ["2xx", "3xx", "401", "403", "404", "409", "410", "416"]
#: tus has answers of its own to a version that is not its own, and to damaged bytes; sizes are a setting
OF_TUS = ("create_upload", "append_to_upload")
REFUSED = ["400", "401", "403", "404", "405", "406", "409", "412", "413", "415", "422", "429"]
#: of /metrics
TOKEN = "figures-of-the-contract"


@dataclass(frozen=True)
class Hunt:
    """What came of a run: how many cases there were, and what the tool said."""

    cases: int
    found: bool
    said: str


@contextmanager
def open_service(folder: Path) -> Iterator[tuple[Api, str]]:
    """A service with a key that may do much, and the key. Streams of events are short."""
    with mock.patch.object(events, "MAX_STREAM_S", 1.0):
        yield from _running(folder)


def _running(folder: Path) -> Iterator[tuple[Api, str]]:
    token = SecretStr(TOKEN)
    settings = Settings(data_dir=folder / "data", reap_interval_s=3600, preview_timeout_s=60, metrics_token=token)
    for api in serve(settings):
        database = api.services.database
        with database.write() as session:
            _, key = keys.create(session, "fuzz", keys.Limits(10**6, 10**6, 10**12), now=database.now())
        with preview_worker(api):
            yield api, key


def things(api: Api, key: str) -> dict[str, str]:
    """Ids of what there is: a video, a reference, a job and its result, by the names of path parameters."""
    headers = {"Authorization": f"Bearer {key}"}
    made = {}
    for name, path in (("video_id", "/v1/videos"), ("reference_id", "/v1/references")):
        made[name] = api.client.post(path, content=MP4, headers=headers).raise_for_status().json()["id"]
        make_ready(api.services, made[name])
    body = {
        "video": made["video_id"],
        "looks": [{"reference": made["reference_id"]}],
        "output": {"extras": ["cube", "matte"]},
    }
    body["webhook"] = {"url": "https://receiver.invalid/"}
    made["job_id"] = api.client.post("/v1/transfer", json=body, headers=headers).raise_for_status().json()["id"]
    parts = [("look.cube", 1, b"TITLE"), ("matte", 1, b"matte")]
    (made["result_id"],) = make_results(api.services, made["job_id"], [b"result"], parts=parts)  # type: ignore[arg-type]
    (told,) = api.client.get("/v1/webhooks", headers=headers).raise_for_status().json()["data"]
    made["webhook_id"] = told["id"]
    link = api.client.post("/v1/uploads/link", json={}, headers=headers).raise_for_status().json()
    made["upload_id"] = link["id"]
    return made


def configured(key: str) -> str:
    """The tool's configuration: keys of both kinds, and which answers are right beyond those it knows."""
    text = f'[auth.openapi.key]\nbearer = "{key}"\n[auth.openapi.metrics]\nbearer = "{TOKEN}"\n'
    for one in sorted({*BETWEEN_FIELDS, *CONDITIONAL, *OF_TUS}):
        text += f'[[operations]]\ninclude-operation-id = "{one}"\n'
        if one in BETWEEN_FIELDS or one in CONDITIONAL:
            accepted = [*ACCEPTED, "422" if one in BETWEEN_FIELDS else "412"]
            accepted += ["400", "413", "460"] if one in OF_TUS else []
            text += f"checks.positive_data_acceptance.expected-statuses = {json.dumps(accepted)}\n"
        if one in OF_TUS:
            text += f"checks.negative_data_rejection.expected-statuses = {json.dumps(REFUSED)}\n"
            text += f"checks.missing_required_header.expected-statuses = {json.dumps(REFUSED)}\n"
    return text


def hunt(folder: Path, *, seed: int, examples: int, seconds: int, phases: str = "examples,coverage,fuzzing") -> Hunt:
    """Run schemathesis for at most so many seconds, in a process of its own."""
    with open_service(folder) as (api, key):
        config = folder / "schemathesis.toml"
        config.write_text(configured(key))
        command = [
            *(sys.executable, "-m", "schemathesis.cli", "--config-file", str(config), "run"),
            *(f"{api.client.base_url}/openapi.json", "--checks", "all", "--phases", phases, "--no-color"),
            *("--seed", str(seed), "--max-examples", str(examples)),
            *("--max-time", str(seconds), "--continue-on-failure", "--workers", "1", "--generation-database", "none"),
            # a busy machine takes its time
            *("--request-timeout", "60", "--max-response-time", "60"),
        ]
        environment = os.environ | {
            "SCHEMATHESIS_HOOKS": "tests.contract.hooks",
            "PYTHONPATH": str(FOLDER.parents[1]),
            "CONTRACT_IDS": json.dumps(things(api, key)),
        }
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    said = done.stdout + done.stderr
    cases = re.search(r"(\d+) generated", said)
    return Hunt(int(cases[1]) if cases else 0, done.returncode != 0, said)


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.contract.fuzzing", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--minutes", type=float, default=2.0)
    parser.add_argument("--seed", type=int, default=int(time.time()))
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        phases = "examples,coverage,fuzzing,stateful"
        found = hunt(Path(folder), seed=given.seed, examples=1000, seconds=int(60 * given.minutes), phases=phases)
    print(found.said)
    return 1 if found.found else 0


if __name__ == "__main__":
    sys.exit(main())
