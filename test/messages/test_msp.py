# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Frames of MSP: published examples, and what a line makes of them."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from quad_mpc_ros.messages import msp


def answer_v1(command: int, payload: bytes, direction: bytes = b">") -> bytes:
    """As the protocol's wiki has it: $M, direction, size, type, data, checksum."""
    checksum = len(payload) ^ command
    for byte in payload:
        checksum ^= byte
    return b"$M" + direction + bytes([len(payload), command]) + payload + bytes([checksum])


def test_request_without_payload() -> None:
    # MSP_IDENT (100) and MSP_STATUS (101) as terminals send them.
    assert msp.request(100) == b"$M<\x00dd"
    assert msp.request(101) == b"$M<\x00ee"


def test_channels_are_little_endian() -> None:
    assert msp.raw_rc((1000, 2000)) == answer_v1(200, b"\xe8\x03\xd0\x07", b"<")


@given(st.lists(st.tuples(st.integers(0, 254), st.binary(max_size=40)), max_size=4), st.data())
def test_finds_answers_in_any_fragments(
    answers: list[tuple[int, bytes]], data: st.DataObject
) -> None:
    """In pieces, with noise before and between that has no frame's beginning in it."""
    noise = st.binary(max_size=5).filter(lambda found: b"$" not in found)
    line = b"".join(data.draw(noise) + answer_v1(*answer) for answer in answers)
    reader, found = msp.MspReader(), []
    while line:
        size = data.draw(st.integers(1, len(line)))
        found += reader.read(line[:size])
        line = line[size:]
    assert [(answer.command, answer.payload) for answer in found] == answers


@given(st.binary(max_size=200))
def test_accepts_any_bytes(line: bytes) -> None:
    reader = msp.MspReader()
    list(reader.read(line))
    whole = answer_v1(105, b"\x01\x02")
    # What looked like a frame's beginning may swallow some; a line goes on, and they are found.
    assert any(answer.payload == b"\x01\x02" for answer in reader.read(200 * whole))


def test_drops_a_broken_frame_and_finds_the_next() -> None:
    broken = bytearray(answer_v1(105, b"\x01\x02"))
    broken[5] ^= 1
    found = list(msp.MspReader().read(bytes(broken) + answer_v1(106, b"\x03")))
    assert [answer.command for answer in found] == [106]


def test_recognises_refusals() -> None:
    (found,) = msp.MspReader().read(answer_v1(200, b"", b"!"))
    assert found.refused and found.command == 200
