"""Messages between a job's supervisor and its process: JSON, each after its length. Reading one runs nothing."""

from __future__ import annotations

import json
import socket
import struct
from typing import Any, Final

_LENGTH: Final = struct.Struct(">I")
#: of one message: the faces of an hour of crowds need a tenth
MAX_MESSAGE_BYTES: Final = 8 * 2**20
_PIECE_BYTES: Final = 1 << 16


class ProtocolError(Exception):
    """The other side did not keep to what is agreed."""


def send(channel: socket.socket, message: dict[str, Any]) -> None:
    """Send a message whole. Raises `OSError` when the other side is gone, `ValueError` for what is no JSON."""
    data = json.dumps(message, allow_nan=False).encode()
    if len(data) > MAX_MESSAGE_BYTES:
        raise ValueError(f"a message of {len(data)} bytes is too long")
    channel.sendall(_LENGTH.pack(len(data)) + data)


class Receiver:
    """The messages that come in at one end of a channel."""

    def __init__(self, channel: socket.socket) -> None:
        self._channel = channel
        self._data = bytearray()
        self.ended = False

    def read(self) -> list[dict[str, Any]]:
        """Wait for bytes and return the messages that they complete; sets `ended` when the other side has closed.

        Raises `ProtocolError` for what is no message, and `BlockingIOError` as the socket does.
        """
        try:
            piece = self._channel.recv(_PIECE_BYTES)
        except ConnectionResetError:
            piece = b""
        self.ended = not piece
        self._data += piece
        found = []
        while len(self._data) >= _LENGTH.size:
            (length,) = _LENGTH.unpack_from(self._data)
            if length > MAX_MESSAGE_BYTES:
                raise ProtocolError(f"a message of {length} bytes")
            if len(self._data) < _LENGTH.size + length:
                break
            found.append(_message(bytes(self._data[_LENGTH.size : _LENGTH.size + length])))
            del self._data[: _LENGTH.size + length]
        return found


def _message(data: bytes) -> dict[str, Any]:
    try:
        message = json.loads(data, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise ProtocolError("a message that is no JSON") from error
    if not isinstance(message, dict):
        raise ProtocolError("a message that is no object")
    return message


def _refuse(name: str) -> None:
    raise ValueError(f"{name} is no number of JSON")
