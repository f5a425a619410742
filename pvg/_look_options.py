"""The options of a look that `pvg transfer`, `export` and `swap` share.

To add one, name it here as `pvg.transfer` does, with what `argparse` is to know of it; nothing else of the command
lists them.
"""

from __future__ import annotations

from typing import Any, Final

from pvg._option_values import PARTS, PROTECTABLE, beta_of, count_of, makeup_of, protected_of, share_of

# as the library has them, which takes too long to load for a help text
MATCHES: Final = ("color", "semantic")
EXTENTS: Final = ("skin", "face")
MAKEUP, LIGHT, SCENE, BETA, ITERATIONS = 0.75, 0.0, 1.0, 0.2, 20

# in the order of the help
LOOK_OPTIONS: Final[dict[str, dict[str, Any]]] = {
    "strength": {"type": share_of, "default": 1.0, "metavar": "X", "help": "from 0, the clip as it is, to 1 (default)"},
    "match": {
        "choices": MATCHES,
        "default": "semantic",
        "help": "all colours together, or skin to skin, lips to lips (default)",
    },
    "makeup": {
        "type": makeup_of,
        "default": MAKEUP,
        "metavar": "X",
        "help": f"how far {', '.join(PARTS)} take the reference's make-up, from 0 to 1 ({MAKEUP}), "
        f"or by part, e.g. lips=1,lids=0.3; parts left out get {MAKEUP}",
    },
    "light": {
        "type": share_of,
        "default": LIGHT,
        "metavar": "X",
        "help": f"how far light falls from where it does on the reference, from 0 to 1 ({LIGHT})",
    },
    "scene": {
        "type": share_of,
        "default": SCENE,
        "metavar": "X",
        "help": "how far brightness and hue far from the clip's give way to its scene, from 0, which takes the "
        "reference's own, to 1 (default)",
    },
    "protect": {
        "type": protected_of,
        "default": PROTECTABLE,
        "metavar": "LIST",
        "help": 'what follows the skin only in brightness and in half its hue: "eyes", "teeth", "eyes,teeth" (default) '
        'or "none"',
    },
    "beta": {"type": beta_of, "default": BETA, "metavar": "X", "help": f"of eq. (7), above 0, up to 1 ({BETA})"},
    "iterations": {
        "type": count_of,
        "default": ITERATIONS,
        "metavar": "N",
        "help": f"iterations of eq. (7) ({ITERATIONS})",
    },
    "seed": {"type": count_of, "default": 0, "metavar": "N", "help": "of the transport's random rotations (0)"},
    "extent": {"choices": EXTENTS, "default": "skin", "help": "all skin of a person (default), or the face alone"},
}
