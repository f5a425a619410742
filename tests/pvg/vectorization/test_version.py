from __future__ import annotations

import hashlib

from pvg.skin.parameters import SKIN_PRIOR
from pvg.vectorization import VECTORIZER_VERSION


def test_the_numbers_of_the_skin_model_are_those_of_the_version() -> None:
    """With other numbers the same clip gives another asset, and services keep those that have the version.

    Who changes a number raises `VECTORIZER_VERSION` and writes both here.
    """
    numbers = hashlib.sha256(repr(SKIN_PRIOR).encode()).hexdigest()[:16]
    assert (VECTORIZER_VERSION, numbers) == (36, "14cd923db77630b9")
