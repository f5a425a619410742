"""`python -P -m worker.sandbox`: what of the sandbox this machine has. The worker starts its fork server by it too."""

from __future__ import annotations

import sys

from worker.sandbox.server import missing, serve

if __name__ == "__main__":
    if len(sys.argv) > 3:  # …, and the data folder, for people who look at the list of processes
        serve(int(sys.argv[1]), int(sys.argv[2]), sys.argv[4], nice=int(sys.argv[3]))
    else:
        absent = missing()
        print(
            "\n".join(f"not here: {line}" for line in absent)
            or "limits, landlock, seccomp, network namespace: all here"
        )
        sys.exit(1 if absent else 0)
