"""How the faces of a clip are vectorised, and what its reading gave."""

from __future__ import annotations

from dataclasses import dataclass

from pvg.curves import CHAIN_RESET_FRAMES, Matching
from pvg.errors import FaceTooSmallError, NoFaceError
from pvg.landmarks import FaceTrack
from pvg.skin import MaskMethod
from pvg.vectorization.face_messages import no_usable_face
from pvg.vectorization.shared_threads import SharedThreads
from pvg.vectorization.source_reader import SourceReader
from pvg.vectorization.stretch import KeyView
from pvg.vectorization.vector_face import VectorFace


@dataclass(frozen=True, eq=False)
class FaceMaker:
    """Begins the vectorised faces of one clip, all with the same settings; see `pvg.vectorize`."""

    mask: MaskMethod
    matching: Matching
    seed: int
    min_face_px: float
    advised_face_px: float
    threads: SharedThreads

    @property
    def is_chain(self) -> bool:
        """Whether colours are carried from frame to frame, as the paper does."""
        return self.matching == "chain"

    @property
    def uses_scenes(self) -> bool:
        """Whether the whole picture is looked at beside the face's surroundings."""
        return self.mask == "landmarks"

    def face(self, number: int, rows: FaceTrack, key: KeyView) -> VectorFace:
        """A face that begins with these rows."""
        return VectorFace(
            number,
            rows,
            key,
            self.threads,
            mask=self.mask,
            seed=self.seed,
            reset=CHAIN_RESET_FRAMES if self.is_chain else None,
            advised_px=self.advised_face_px,
        )

    def no_usable_face(
        self, source: SourceReader, frame_count: int, *, widest: float, too_brief: bool
    ) -> NoFaceError | FaceTooSmallError:
        """The error for a clip or image without a face that these settings take, see `face_messages`."""
        return no_usable_face(
            source.path.name,
            frame_count,
            widest=widest,
            too_brief=too_brief,
            image=source.is_image,
            min_px=self.min_face_px,
            advised_px=self.advised_face_px,
        )


@dataclass(frozen=True, eq=False)
class FoundFaces:
    """What the reading of a clip gave.

    faces: in any order, all their rows written;  shots: the first frame of each, from 0;  frame_count: of the clip, of
    a reference as far as it was read.
    """

    faces: tuple[VectorFace, ...]
    shots: tuple[int, ...]
    frame_count: int
