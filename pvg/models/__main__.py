"""`python -m pvg.models`: install the network weights into the cache folder."""

from __future__ import annotations

import sys

from pvg.models import MODELS, ModelError, cache_folder, install


def main() -> int:
    """Install the weights and say what was done; 1 with one line on stderr when that fails."""
    try:
        fresh = install()
    except ModelError as error:
        print(f"pvg.models: {error}", file=sys.stderr)
        return 1
    state = "installed" if fresh else "already there"
    print(f"{len(MODELS)} networks {state} in {cache_folder()}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
