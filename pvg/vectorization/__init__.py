"""Algorithm 1, precomputation: a clip becomes an asset, once for all looks."""

from __future__ import annotations

from pvg.vectorization.clip import MIN_FACE_PX, STAGES, VECTORIZER_VERSION, vectorize
from pvg.vectorization.source_reader import Progress

__all__ = ["MIN_FACE_PX", "STAGES", "VECTORIZER_VERSION", "Progress", "vectorize"]
