"""The use cases: what a request makes of the records, the files and the queue."""

from service.api.commands import pieces, resuming, stills
from service.api.commands.asked import Asked
from service.api.commands.checks import WantedLook, WantedOutput, check_look, check_role, check_usable
from service.api.commands.looks import check_looks, find_lost, params_of, request_looks
from service.api.commands.registering import register
from service.api.commands.removal import remove, remove_job, take_back

__all__ = [
    "Asked",
    "WantedLook",
    "WantedOutput",
    "check_look",
    "check_looks",
    "check_role",
    "check_usable",
    "find_lost",
    "params_of",
    "pieces",
    "register",
    "remove",
    "remove_job",
    "request_looks",
    "resuming",
    "stills",
    "take_back",
]
