"""Algorithm 1, precomputation: a clip becomes an asset, once for all looks."""

from __future__ import annotations

from pvg.vectorization.clip import STAGES, VECTORIZER_VERSION, vectorize

__all__ = ["STAGES", "VECTORIZER_VERSION", "vectorize"]
