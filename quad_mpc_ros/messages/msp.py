# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Frames of the MultiWii Serial Protocol, version 1, the protocol of Betaflight.

A frame is ``$M``, direction, size, command, payload and a checksum, the exclusive or of the last
three fields. The direction is ``<`` for requests, ``>`` for answers and ``!`` for errors.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Iterator
from dataclasses import dataclass

SET_RAW_RC = 200

_HEADER_SIZE = 5


@dataclass(frozen=True, kw_only=True)
class Answer:
    """An answer to a command, possibly an error."""

    command: int
    payload: bytes
    refused: bool = False


def request(command: int, payload: bytes = b"") -> bytes:
    """Return a request with a payload of at most 255 bytes as a frame."""
    body = bytes((len(payload), command)) + payload
    return b"$M<" + body + bytes((functools.reduce(operator.xor, body),))


def raw_rc(pulses: tuple[int, ...]) -> bytes:
    """Return the frame that sets a receiver's channels [us]."""
    payload = b"".join(pulse.to_bytes(2, "little") for pulse in pulses)
    return request(SET_RAW_RC, payload)


class MspReader:
    """Finds the answers in a stream of bytes, and discards other bytes."""

    def __init__(self) -> None:
        self._held = b""

    def read(self, data: bytes) -> Iterator[Answer]:
        """Take received bytes; yield every complete answer."""
        self._held += data
        while (start := self._held.find(b"$")) >= 0:
            self._held = self._held[start:]
            if not self._begins():
                self._held = self._held[1:]
                continue
            size = _HEADER_SIZE + 1 + (self._held[3] if len(self._held) > 3 else 0)
            if len(self._held) < size:
                return
            answer = _answer(self._held[:size])
            self._held = self._held[size if answer else 1 :]
            if answer:
                yield answer
        self._held = b""

    def _begins(self) -> bool:
        """Return whether the received bytes can be the start of a frame."""
        return any(start.startswith(self._held[:3]) for start in (b"$M>", b"$M!"))


def _answer(frame: bytes) -> Answer | None:
    """Return the answer in a frame; None for a wrong checksum."""
    body = frame[3:-1]
    if functools.reduce(operator.xor, body) != frame[-1]:
        return None
    return Answer(command=body[1], payload=body[2:], refused=frame[2:3] == b"!")
