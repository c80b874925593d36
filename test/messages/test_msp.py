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


def test_version_2_checksums_are_the_published_ones() -> None:
    # Of the specification of MSPv2: function 100, no payload.
    assert msp.crc8(bytes.fromhex("00 64 00 00 00")) == 0x8F
    # And with payload: function 0x4242, flag 0xa5.
    assert msp.crc8(bytes.fromhex("a5 42 42 12 00") + b"Hello flying world") == 0x82


def test_the_crc_is_that_of_dvb_s2() -> None:
    assert msp.crc8(b"123456789") == 0xBC  # the check value of the catalogue


def test_channels_are_little_endian() -> None:
    assert msp.raw_rc((1000, 2000)) == answer_v1(200, b"\xe8\x03\xd0\x07", b"<")


def test_long_requests_use_version_2() -> None:
    frame = msp.request(200, bytes(300))
    assert frame[:8] == b"$X<\x00\xc8\x00\x2c\x01" and len(frame) == 309


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


def test_reads_version_2_answers() -> None:
    body = b"\x00\x65\x00\x01\x00\x07"
    (found,) = msp.MspReader().read(b"$X>" + body + bytes([msp.crc8(body)]))
    assert (found.command, found.payload) == (0x65, b"\x07")
