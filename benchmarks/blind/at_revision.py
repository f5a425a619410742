"""Draw frames with whatever version of the library is first on the path; run as a file, by its public names alone.

`python -P at_revision.py JOBS.json`: {"folder": ..., "jobs": [{"clip", "reference", "frames", "point", "out"}, ...]}.
Each job's pictures are written to `out` (.npz, "frames": (n, H, W, 3) uint8 RGB). point: (x, y) of the middle of the
wanted face in the first of `frames`, for faces may be numbered otherwise here.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

import pvg


def _face(video: Any, frame: int, point: list[float]) -> int:
    """The face whose middle lies nearest to a point of a frame."""
    away: dict[int, float] = {}
    for face in video.faces:
        data = video.face_at(face.index, frame)
        if data is not None:
            points = getattr(data.landmarks, "points", data.landmarks)
            away[face.index] = float(np.linalg.norm(np.asarray(points).mean(axis=0) - point))
    return min(away, key=lambda index: away[index])


def main() -> None:
    """Vectorise what the jobs name, once each, and draw."""
    work = json.loads(Path(sys.argv[1]).read_text())
    folder = Path(work["folder"])
    opened: dict[tuple[str, bool], Any] = {}

    def vectorized(path: str, reference: bool) -> Any:
        if (path, reference) not in opened:
            asset = folder / f"{Path(path).stem}{'.reference' * reference}.pvg"
            opened[path, reference] = pvg.vectorize(path, asset=asset, reference=reference)
        return opened[path, reference]

    for job in work["jobs"]:
        video, reference = vectorized(job["clip"], False), vectorized(job["reference"], True)
        look = pvg.transfer(video, reference, faces=[_face(video, job["frames"][0], job["point"])])
        frames = np.stack([pvg.render_frame(video, look, index) for index in job["frames"]])
        np.savez_compressed(job["out"], frames=frames)
        print(f"{Path(job['clip']).stem} with {Path(job['reference']).stem}", flush=True)


if __name__ == "__main__":
    main()
