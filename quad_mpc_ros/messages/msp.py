"""Frames of the MultiWii Serial Protocol, versions 1 and 2, the protocol of Betaflight.

Version 1 is ``$M``, direction, size, command, payload and the exclusive or of the last three;
version 2 ``$X``, direction, a flag of 0, command and size of two bytes each, little endian,
payload and their CRC-8 (DVB-S2). The direction is ``<`` for requests, ``>`` for answers and ``!``
for refusals.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Iterator
from dataclasses import dataclass

SET_RAW_RC = 200

_MAX_SIZE_V1 = 254
_MAX_SIZE = 1024  # of an answer: more than any is
_HEADER_V1, _HEADER_V2 = 5, 8
_POLYNOMIAL = 0xD5


@dataclass(frozen=True, kw_only=True)
class Answer:
    """An answer to a command, which may be a refusal."""

    command: int
    payload: bytes
    refused: bool = False


def request(command: int, payload: bytes = b"") -> bytes:
    """Return a request as a frame, of version 1 where that can hold it."""
    if command < 255 and len(payload) <= _MAX_SIZE_V1:
        body = bytes((len(payload), command)) + payload
        return b"$M<" + body + bytes((functools.reduce(operator.xor, body),))
    body = b"\0" + command.to_bytes(2, "little") + len(payload).to_bytes(2, "little") + payload
    return b"$X<" + body + bytes((crc8(body),))


def raw_rc(pulses: tuple[int, ...]) -> bytes:
    """Return the frame that sets a receiver's channels [us]."""
    payload = b"".join(pulse.to_bytes(2, "little") for pulse in pulses)
    return request(SET_RAW_RC, payload)


def crc8(data: bytes) -> int:
    """Return the CRC-8 of DVB-S2: polynomial 0xD5, from 0, not reflected."""
    crc = 0
    for byte in data:
        crc = _CRC[crc ^ byte]
    return crc


def _shifted(value: int) -> int:
    for _ in range(8):
        value = (value << 1) ^ (_POLYNOMIAL if value & 0x80 else 0)
    return value & 0xFF


_CRC = tuple(_shifted(value) for value in range(256))


class MspReader:
    """Finds the answers in a stream of bytes, and drops what is no frame."""

    def __init__(self) -> None:
        self._held = b""

    def read(self, data: bytes) -> Iterator[Answer]:
        """Take received bytes; yield every complete answer."""
        self._held += data
        while (start := self._held.find(b"$")) >= 0:
            self._held = self._held[start:]
            size = self._size()
            if size is None:
                return
            answer = self._answer(size) if size else None
            self._held = self._held[size if answer else 1 :]
            if answer:
                yield answer
        self._held = b""

    def _size(self) -> int | None:
        """Return how long the frame is; 0 where none begins, None where that is not yet known."""
        held = self._held
        if held[:3] not in (b"$M>", b"$M!", b"$X>", b"$X!"):
            return None if len(held) < 3 and held in (b"$", b"$M", b"$X") else 0
        is_first = held[1:2] == b"M"
        if len(held) < (_HEADER_V1 if is_first else _HEADER_V2):
            return None
        count = held[3] if is_first else int.from_bytes(held[6:8], "little")
        if count > _MAX_SIZE:
            return 0
        size = (_HEADER_V1 if is_first else _HEADER_V2) + count + 1
        return size if len(held) >= size else None

    def _answer(self, size: int) -> Answer | None:
        frame, refused = self._held[:size], self._held[2:3] == b"!"
        body, check = frame[3:-1], frame[-1]
        if frame[1:2] == b"M":
            if functools.reduce(operator.xor, body) != check:
                return None
            return Answer(command=body[1], payload=body[2:], refused=refused)
        if crc8(body) != check:
            return None
        command = int.from_bytes(body[1:3], "little")
        return Answer(command=command, payload=body[5:], refused=refused)
