"""Assets of made-up arrays, written without a clip being followed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pvg.asset import CHUNK_FRAMES, AssetWriter, FaceRecord, FaceSummary, KeyFrame
from pvg.curves import BOUNDARY_SAMPLES, table_labels
from pvg.face import layout
from pvg.video import sha256_file

FRAMES = CHUNK_FRAMES * 2 + 5
FIRST = 3
SUMMARY = FaceSummary(0, FIRST, FIRST + FRAMES - 1, 150.0, (200, 150, 120), 0, ("small",))


def frame_arrays(i: int) -> dict[str, np.ndarray]:
    """What an asset keeps of a face in one frame, different for every `i`."""
    rng = np.random.default_rng(i)
    matte = np.zeros((60, 50), np.uint8)
    matte[10:50, 8:42] = rng.integers(200, 256)
    return {
        "points": (rng.uniform(50, 200, (layout.LANDMARK_COUNT, 2)) + i).astype(np.float32),
        "skin_points": rng.uniform(50, 200, (layout.SKIN_COUNT, 2)).astype(np.float32),
        "radius": rng.uniform(40, 90, BOUNDARY_SAMPLES).astype(np.float32),
        "score": np.array([0.5 + 0.4 * np.sin(i)], np.float32),
        "pose": rng.uniform(-20, 20, 3).astype(np.float32),
        "box": np.array([10 + i, 20, 230 + i, 284], np.float32),
        "matte": matte,
        "body": np.where(np.arange(160 * 120).reshape(120, 160) % 100 < 20 + i, 255, 0).astype(np.uint8),
    }


def key_frame() -> KeyFrame:
    """Boundary colours at random."""
    rng = np.random.default_rng(99)
    colors = rng.uniform(0, 255, (len(table_labels()), 3)).astype(np.float32)
    return KeyFrame(
        FIRST,
        colors,
        rng.random(len(colors)) > 0.1,
        rng.uniform(0, 255, (64, 3)).astype(np.float32),
        rng.integers(0, len(colors), 64).astype(np.int16),
        rng.uniform(0, 255, (4, 3)).astype(np.float32),
    )


def manifest_of(source: Path, frame_count: int, shots: tuple[int, ...] = (0,)) -> dict[str, object]:
    """What the manifest says of a source file that is taken for a clip."""
    media = {"kind": "video", "width": 320, "height": 240, "frame_rate": 25.0, "duration_s": 3.0}
    media |= {"frame_count": frame_count, "has_audio": False, "rotation": 0}
    media |= {"codec": "h264", "pixel_format": "yuv420p"}
    return {
        "vectorizer": "test",
        "settings": {"mask": "landmarks", "matching": "table", "reference": False, "input_color": "auto"},
        "source_name": source.name,
        "source_sha256": sha256_file(source),
        "media": media,
        "shots": list(shots),
    }


def write_asset(path: Path, source: Path, *, seed: int = 0) -> Path:
    """One face over FRAMES frames, from frame FIRST on; with another seed it is elsewhere."""
    with AssetWriter(path) as writer:
        for i in range(FRAMES):
            writer.add_frame(0, frame_arrays(seed + i))
        writer.add_face(FaceRecord(SUMMARY, (key_frame(),)))
        writer.finish(manifest_of(source, FIRST + FRAMES, shots=(0, 40)))
    return path
