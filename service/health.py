"""Whether this machine's API or workers are well, for supervisors of containers: `pvg-service health`.

It is asked for every few seconds and loads little: neither the API nor the records, only the driver of the database.
"""

from __future__ import annotations

import http.client
import ipaddress
import json
import socket
import sqlite3
from contextlib import closing
from typing import Final, Literal

from service.ids import host_of, worker_id
from service.settings import Settings

Kind = Literal["jobs", "previews"]
Part = Literal["api", "jobs", "previews"]

_TIMEOUT_S: Final = 4.0
_QUERY: Final = "SELECT id, {age}, lacks FROM workers WHERE kind = {mark} ORDER BY seen_at DESC"
_SQLITE_AGE: Final = "(julianday('now') - julianday(seen_at)) * 86400"
_POSTGRESQL_AGE: Final = "extract(epoch FROM clock_timestamp() - seen_at)::float8"


def report(settings: Settings, part: Part) -> int:
    """Print a line that tells how a part of the service is, and return the exit status: 0 when it is well."""
    well, line = of_api(settings) if part == "api" else of_workers(settings, part)
    print(line)
    return 0 if well else 1


def of_api(settings: Settings) -> tuple[bool, str]:
    """Whether the API at this machine's own port says that it is ready, and a line that says what it said."""
    host = _own_address(settings.host)
    connection = http.client.HTTPConnection(host, settings.port, timeout=_TIMEOUT_S)
    try:
        # a name that it knows, wherever it listens
        connection.request("GET", "/readyz", headers={"Host": "localhost"})
        answer = connection.getresponse()
        said = json.loads(answer.read(65_536))
        missing = [f"{part} {state}" for part, state in said["checks"].items() if state != "ok"]
        return answer.status == http.client.OK, ": ".join(filter(None, (said["status"], ", ".join(missing))))
    except (OSError, http.client.HTTPException, ValueError, LookupError, TypeError, AttributeError) as error:
        return False, f"no answer at {host}:{settings.port}: {error}"
    finally:
        connection.close()


def _own_address(host: str) -> str:
    """Where this machine reaches what listens at ``host``."""
    try:
        address = ipaddress.ip_address(host or "0.0.0.0")  # noqa: S104 - compared, not bound
    except ValueError:
        return host
    if address.is_unspecified:
        return "127.0.0.1" if isinstance(address, ipaddress.IPv4Address) else "::1"
    return host


def of_workers(settings: Settings, kind: Kind) -> tuple[bool, str]:
    """Whether a worker of this kind on this machine has said lately that it is alive and can work, and a line."""
    try:
        found = _beats(settings, kind)
    except sqlite3.Error as error:
        return False, f"the database cannot be asked: {error}"
    except Exception as error:  # psycopg is loaded only where it is used
        return False, f"the database cannot be asked: {type(error).__name__}"
    lately = [(age, lacks) for age, lacks in found if age <= settings.silent_s]
    able = [age for age, lacks in lately if lacks is None]
    if able:
        return True, f"ok: {len(able)} alive, heard of {max(0.0, min(able)):.1f} s ago"
    if lately:
        return False, f"no {lately[0][1]}"
    return False, f"silent for {found[0][0]:.0f} s" if found else f"no worker of {kind} on {socket.gethostname()}"


def _beats(settings: Settings, kind: Kind) -> list[tuple[float, str | None]]:
    """Of each of this machine's workers: seconds since its heartbeat, by the database's clock, and what it lacks."""
    here = host_of(worker_id())
    # the whole name: another machine's may begin as this one's does
    return [(age, lacks) for worker, age, lacks in _every_beat(settings, kind) if host_of(worker) == here]


def _every_beat(settings: Settings, kind: Kind) -> list[tuple[str, float, str | None]]:
    if settings.database_file is not None:
        address = f"{settings.database_file.resolve().as_uri()}?mode=ro"
        with closing(sqlite3.connect(address, uri=True, timeout=_TIMEOUT_S)) as opened:
            return opened.execute(_QUERY.format(age=_SQLITE_AGE, mark="?"), (kind,)).fetchall()
    import psycopg  # noqa: PLC0415 - not needed with SQLite

    scheme, _, rest = settings.database.partition("://")
    if not scheme.startswith("postgresql"):
        raise ValueError(scheme)
    with psycopg.connect(f"postgresql://{rest}", connect_timeout=round(_TIMEOUT_S)) as server:
        return server.execute(_QUERY.format(age=_POSTGRESQL_AGE, mark="%s").encode(), (kind,)).fetchall()
