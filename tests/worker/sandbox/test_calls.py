"""The calls of a job on media, in the process of the tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import pvg
from pvg.video import read_frames
from scripts.samples import Samples
from tests.gallery.clips import encode_raw, libav_frame
from worker.sandbox import calls


def test_a_clip_whose_tags_are_not_read_is_vectorised_by_the_colours_that_it_is_said_to_have(
    samples: Samples, tmp_path: Path
) -> None:
    """As some cameras tag their logarithm."""
    pictures = [libav_frame(frame.rgb()) for frame in read_frames(samples.woman_clip, stop=2)]
    options = {"preset": "ultrafast", "x264-params": "transfer=log100"}
    clip = encode_raw(tmp_path / "log.mp4", pictures, "libx264", **options)
    arguments = {"source": str(clip), "asset": str(tmp_path / "log.pvg"), "pictures": str(tmp_path / "pictures")}
    settings = {"reference": False, "input_color": "slog3", "mask": "landmarks", "matching": "table"}
    arguments |= {"limits": {}, "memory_bytes": 2**33, "options": settings}
    answer = calls.CALLS["vectorize"](arguments, lambda *_: None)
    assert answer["output"] == {"container": "mp4", "refused": None, "lost": []}


class Crowd:
    """Stills of one face more than have a picture of their own, the narrowest in the middle."""

    def __init__(self) -> None:
        widths = [40 + abs(number - 50) for number in range(calls.MOST_THUMBNAILS + 1)]
        faces = [SimpleNamespace(index=index, width_px=width) for index, width in enumerate(widths)]
        self.video = SimpleNamespace(faces=faces)

    def usual_frame(self) -> int:
        return 0

    def drawn(self, look: None, frame: int) -> Any:
        return np.zeros((90, 160, 3), np.uint8)

    def seen_faces(self, faces: Sequence[int], size_px: int) -> list[Any]:
        picture = np.zeros((size_px, size_px, 3), np.uint8)
        return [SimpleNamespace(index=face, picture=picture, frame=0, box=(0, 0, 40, 40)) for face in sorted(faces)]


def test_a_face_that_a_frame_does_not_show_is_an_error_of_its_own() -> None:
    def absent(face: int, index: int) -> None:
        raise ValueError(f"face {face} is not in frame {index}")

    with pytest.raises(calls.AbsentFaceError, match="face 2 is not in frame 7"), calls._options_that_fit():
        calls._face_box(SimpleNamespace(face_box=absent), 2, 7)  # type: ignore[arg-type]


def test_of_many_faces_the_widest_have_a_picture(tmp_path: Path) -> None:
    seen, pictures = calls._show(Crowd(), tmp_path / "pictures")  # type: ignore[arg-type]
    shown = [index for index in range(101) if index != 50]
    assert calls.MOST_THUMBNAILS == 100
    assert sorted(seen) == shown
    assert [one["face"] for one in pictures] == [None, *shown]
    assert pictures[-1]["end"] == (tmp_path / "pictures").stat().st_size


def test_a_matte_that_looks_have_alike_is_drawn_once(
    video: pvg.VectorVideo,
    dark_reference: pvg.VectorVideo,
    pale_reference: pvg.VectorVideo,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each look still has files of its own, the same that it would have alone."""
    options: list[dict[str, Any]] = [{}, {"contrast": 1.2}, {"extent": "face"}, {"makeup": 0.0}]
    references = (dark_reference, dark_reference, pale_reference, pale_reference)
    looks = [pvg.transfer(video, one, **given) for one, given in zip(references, options, strict=True)]
    alone = [pvg.export(video, look, tmp_path / f"alone-{k}") for k, look in enumerate(looks)]
    asked: list[list[str]] = []

    def export(*given: Any, parts: list[str], **more: Any) -> list[Path]:
        asked.append(parts)
        return pvg.export(*given, parts=parts, **more)

    monkeypatch.setattr(calls, "pvg", SimpleNamespace(export=export))
    folders = [str(tmp_path / f"extras-{k}") for k in range(len(looks))]
    arguments = {"output": {"extras": ["cube", "matte"], "matte": "ffv1"}, "extras": folders}
    shares: list[int] = []
    made = calls._export(video, looks, arguments, lambda _, done, whole: shares.append(done))
    assert [part[-1] for part in asked] == ["matte", "matte", "matte", "cube"]  # a number's matte is the paper's
    assert shares == sorted(shares)
    for folder, own, extras in zip(folders, alone, made, strict=True):
        assert [extra["name"] for extra in extras] == ["look.cube", "matte.mkv"]
        for name, before in zip(("look.cube", "matte.mkv"), own, strict=False):
            assert (Path(folder) / name).read_bytes() == before.read_bytes()
