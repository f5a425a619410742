"""Passes over a clip: its frames read once, drawn with several looks and handed to a writer each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any, BinaryIO, Final, Protocol, TypeVar

from pvg._allocator import give_back, map_large_blocks
from pvg._targets import begin_draft, draft_of
from pvg._threads import Sink, ahead
from pvg.asset import VectorVideo
from pvg.looks import Look
from pvg.rendering.renderer import Renderer
from pvg.video import Frame, Patch

Progress = Callable[[str, int, int], None]
Target = TypeVar("Target", Path, Path | BinaryIO)

LOOKS_AT_ONCE: Final = 3  # an encoder holds tens of frames: more looks are drawn in further passes over the clip
MEMORY_BYTES: Final = 6 * 2**30


class FrameWriter(AbstractContextManager[Any], Protocol):
    """What takes frames, such as `VideoWriter`."""

    def write(self, frame: Frame, patches: Sequence[Patch] = ()) -> None:
        """Take one frame, with what is laid over it."""


def check_paths(items: Sequence[object], paths: Sequence[str | Path | BinaryIO]) -> None:
    """Raise ValueError unless there is one path for each of the looks."""
    for name, given in (("looks", items), ("paths", paths)):
        if isinstance(given, (str, Path)) or not isinstance(given, Sequence):
            raise ValueError(f"{name} must be a sequence, one for each look, not {type(given).__name__}")
    if len(items) != len(paths):
        raise ValueError(f"{len(items)} looks need {len(items)} paths, not {len(paths)}")


@contextmanager
def drafts_of(targets: Sequence[Target]) -> Iterator[list[Target]]:
    """What is written to in the place of each target: a draft beside a file, a stream itself.

    Drafts get their names when the block is left well, and are removed otherwise.
    """
    drafts = [draft_of(target) if isinstance(target, Path) else target for target in targets]
    try:
        for draft, target in zip(drafts, targets, strict=True):
            if isinstance(draft, Path) and isinstance(target, Path):
                begin_draft(draft, target)
        yield drafts
        for draft, target in zip(drafts, targets, strict=True):
            if isinstance(draft, Path) and isinstance(target, Path):
                draft.replace(target)
    finally:
        for draft in drafts:
            if isinstance(draft, Path):
                draft.unlink(missing_ok=True)


def draw(
    video: VectorVideo,
    looks: Sequence[Look],
    frames: Callable[[], Iterator[Frame]],
    writer: Callable[[int], FrameWriter],
    *,
    count: int,
    at_once: int,
    progress: Progress | None,
) -> None:
    """Draw each look into the writer of its number, `at_once` of them in one pass over the `count` frames."""
    passes = [range(i, min(i + at_once, len(looks))) for i in range(0, len(looks), at_once)]
    if len(passes) > 1:  # a single one has nothing to gain, and large blocks are had sooner from the heap
        map_large_blocks()
    for number, numbers in enumerate(passes):
        if len(passes) > 1:
            give_back()  # also what the encoders of the pass before held

        def told(done: int, before: int = number * count) -> None:
            if progress is not None:
                progress("render", before + done, len(passes) * count)

        _draw_at_once(Renderer(video, [looks[k] for k in numbers]), frames, [writer(k) for k in numbers], told)


def _draw_at_once(
    renderer: Renderer,
    frames: Callable[[], Iterator[Frame]],
    writers: Sequence[FrameWriter],
    told: Callable[[int], None],
) -> None:
    """Draw each look of a renderer into the writer in its place; told: how many frames are drawn, after each."""
    with ExitStack() as stack:
        for one in writers:
            stack.enter_context(one)
        sinks = [stack.enter_context(Sink(_writing(one))) for one in writers]
        drawn = stack.enter_context(closing(ahead(frames())))
        for done, frame in enumerate(drawn, 1):
            for sink, patches in zip(sinks, renderer.patches(frame), strict=True):
                sink.put((frame, patches))
            told(done)


def _writing(writer: FrameWriter) -> Callable[[tuple[Frame, list[Patch]]], None]:
    return lambda item: writer.write(*item)
