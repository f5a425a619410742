"""The table of settings in docs/operations.md, made from the class that reads them.

python -m scripts.settings_table            # prints it
python -m scripts.settings_table --write    # into the page
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Final

from pydantic import SecretStr

from service.settings import FILE_ENDING, FROM_FILES, Settings

PAGE: Final = Path(__file__).resolve().parents[1] / "docs" / "operations.md"
BEGIN: Final = "<!-- settings: made by `python -m scripts.settings_table --write` -->"
END: Final = "<!-- end of settings -->"
#: read by the library, which knows no service
_OF_THE_LIBRARY: Final = (
    "| `PVG_CACHE_DIR` | `~/.cache/pvg` | Network weights, as `python -m pvg.models` leaves them, and compiled kernels "
    "where they cannot be beside the modules. |"
)


def table() -> str:
    """Every setting with its default and what is said of it, in the order of the class."""
    lines = ["| variable | default | meaning |", "|---|---|---|"]
    for name, field in Settings.model_fields.items():
        meaning = " ".join((field.description or "").split())
        if name in FROM_FILES:
            meaning += f" Or a file that holds it: `PVG_{name.upper()}{FILE_ENDING}`."
        lines.append(f"| `PVG_{name.upper()}` | {_shown(field.default)} | {meaning} |")
    return "\n".join([*lines, _OF_THE_LIBRARY])


def _shown(default: object) -> str:
    if isinstance(default, SecretStr):
        default = default.get_secret_value()
    if isinstance(default, bool):
        default = str(default).lower()
    if isinstance(default, float) and default.is_integer():
        default = int(default)
    return "" if default == "" else f"`{default}`"


def with_table(page: str) -> str:
    """The page with the table of today between its two marks. Raises `ValueError` when it has no such marks."""
    made, times = re.subn(f"(?<={BEGIN}\n).*?(?={END})", lambda _: table() + "\n", page, flags=re.DOTALL)
    if times != 1:
        raise ValueError(f"the page needs {BEGIN} and {END} once")
    return made


def main() -> int:
    """Print the table, or write it into the page."""
    if sys.argv[1:] == ["--write"]:
        PAGE.write_text(with_table(PAGE.read_text()))
    else:
        print(table())
    return 0


if __name__ == "__main__":
    sys.exit(main())
