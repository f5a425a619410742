"""Ask the public lists of known weaknesses about every locked dependency, by pip-audit, and say plainly what was asked.

Exit status: 0 nothing known, 1 something is, 2 no list could be asked, which proves nothing.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import venv
from pathlib import Path
from typing import Any

LOCK = Path(__file__).resolve().parents[1] / "requirements" / "all.txt"
PIP_AUDIT = "pip-audit==2.10.1"
SERVICES = ("pypi", "osv")
CLEAN, KNOWN, NOT_ASKED = 0, 1, 2


def audited(command: list[str], lock: Path, service: str) -> tuple[int, str]:
    """What a service knows of the locked versions: (CLEAN, KNOWN or NOT_ASKED, the report or the reason)."""
    options = ["--require-hashes", "--disable-pip", "--progress-spinner", "off", "--timeout", "15", "-f", "json"]
    done = subprocess.run(
        [*command, "-r", str(lock), "-s", service, *options], capture_output=True, text=True, check=False
    )
    try:
        found = json.loads(done.stdout)["dependencies"]
    except ValueError:
        return NOT_ASKED, (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
    return judged(found)


def judged(dependencies: list[dict[str, Any]]) -> tuple[int, str]:
    """The verdict on a report's dependencies. A registry that has no such list says of each that it was skipped."""
    asked = [one for one in dependencies if "skip_reason" not in one]
    if not asked:
        return NOT_ASKED, f"none of {len(dependencies)} dependencies is known to it"
    known = [f"{one['name']} {one['version']}: {weakness['id']}" for one in asked for weakness in one["vulns"]]
    head = f"{len(asked)} of {len(dependencies)} dependencies audited, {len(known)} known weaknesses"
    return (KNOWN if known else CLEAN), "\n".join([head, *known])


def main() -> int:
    """Audit with the first service that answers."""
    with tempfile.TemporaryDirectory() as folder:
        venv.create(folder, with_pip=True)
        python = str(Path(folder) / "bin" / "python")
        install = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", PIP_AUDIT]
        if subprocess.run(install, check=False).returncode:
            print("not audited: pip-audit cannot be installed here", file=sys.stderr)
            return NOT_ASKED
        for service in SERVICES:
            found, said = audited([python, "-m", "pip_audit"], LOCK, service)
            if found != NOT_ASKED:
                print(f"asked {service} about {LOCK.name}:\n{said}")
                return found
            print(f"{service} cannot be asked: {said[:300]}", file=sys.stderr)
    print("not audited: no list of known weaknesses can be reached from here, so nothing is known", file=sys.stderr)
    return NOT_ASKED


if __name__ == "__main__":
    sys.exit(main())
