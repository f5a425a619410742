"""Names and values of a client's own as a query or a form has them: `name:value`, given again for each."""

from __future__ import annotations

from collections.abc import Sequence

from pydantic import TypeAdapter, ValidationError

from service.api.problems import invalid_values
from service.api.schemas import MetadataPairs

_PAIRS: TypeAdapter[list[str]] = TypeAdapter(MetadataPairs)


def to_metadata(pairs: Sequence[str], where: str = "/metadata") -> dict[str, str]:
    """The names and their values; ``where`` they stand in the request, as a JSON pointer.

    Raises `ValidationFailedError` for what is malformed, too much, or named twice.
    """
    try:
        checked = _PAIRS.validate_python(list(pairs))
    except ValidationError as error:
        detail = "at most 16 times name:value, names of up to 40 of A-Z a-z 0-9 _ . -, values of up to 200 characters"
        raise invalid_values({where: detail}) from error
    split = [pair.partition(":") for pair in checked]
    found = {name: value for name, _, value in split}
    if len(found) < len(split):
        raise invalid_values({where: "a name is given more than once"})
    return found
