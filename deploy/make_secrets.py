"""Passwords for the compose file's profile `scaled`, one a file: `python3 deploy/make_secrets.py secrets`.

What is there stays as it is. The folder is closed to other users of this machine; the files in it are not, since a
container's user, a number of its own, reads them through its mount.
"""

from __future__ import annotations

import secrets
import sys
from pathlib import Path


def make(folder: Path, host: str = "postgres") -> list[str]:
    """Write what is missing; returns the names. A database URL is made of the password that is there."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    folder.chmod(0o700)
    made = []

    def write(name: str, text: str) -> str:
        path = folder / name
        if not path.exists():
            path.write_text(text)
            path.chmod(0o644)
            made.append(name)
        return path.read_text().strip()

    password = write("postgres_password", secrets.token_urlsafe(32))
    write("database_url", f"postgresql://pvg:{password}@{host}/pvg")
    write("link_secret", secrets.token_urlsafe(32))
    write("metrics_token", secrets.token_urlsafe(32))
    return made


if __name__ == "__main__":
    print(*make(Path(sys.argv[1] if len(sys.argv) > 1 else "secrets")) or ["all there"], sep="\n")
