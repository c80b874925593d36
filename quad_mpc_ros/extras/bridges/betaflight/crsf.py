"""Frames of CRSF, the protocol of Crossfire and ExpressLRS receivers.

A frame is address, size of what follows, type, payload and the CRC-8 (DVB-S2) of the last two.
After https://github.com/crsf-wg/crsf/wiki. Numbers of more than a byte are big endian, but
for channels, of which sixteen of 11 bits are packed from the lowest bit on.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from quad_mpc_ros.messages.msp import crc8

BATTERY, CHANNELS_PACKED, ATTITUDE, FLIGHT_MODE = 0x08, 0x16, 0x1E, 0x21

_FLIGHT_CONTROLLER = 0xC8
_ADDRESSES = frozenset((0xC8, 0xEA, 0xEE, 0xEC))
_COUNT, _BITS = 16, 11
_LEAST, _MOST = 2, 62  # of type, payload and check
# What a receiver of ticks makes of them: 172 is 988 us, 1811 is 2012 us.
_TICKS, _TICK_AT_988 = (1811 - 172) / (2012 - 988), 172


def frame(kind: int, payload: bytes) -> bytes:
    """Return a frame to the flight controller."""
    body = bytes((kind,)) + payload
    return bytes((_FLIGHT_CONTROLLER, len(body) + 1)) + body + bytes((crc8(body),))


def channels(pulses: Sequence[float]) -> bytes:
    """Return the frame of pulse widths [us], of up to sixteen channels; the others are low."""
    packed = 0
    for channel in range(_COUNT):
        pulse = pulses[channel] if channel < len(pulses) else 1000.0
        ticks = round(_TICK_AT_988 + (pulse - 988.0) * _TICKS)
        packed |= min(max(ticks, 0), 2**_BITS - 1) << (_BITS * channel)
    return frame(CHANNELS_PACKED, packed.to_bytes(_COUNT * _BITS // 8, "little"))


class Reader:
    """Finds the frames in what comes over a line, and drops what is none."""

    def __init__(self) -> None:
        self._held = b""

    def read(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Take what came; yield type and payload of every frame that is whole."""
        self._held += data
        while len(self._held) >= 2:
            size = self._held[1]
            if self._held[0] not in _ADDRESSES or not _LEAST <= size <= _MOST:
                self._held = self._held[1:]
                continue
            if len(self._held) < 2 + size:
                return
            body, check = self._held[2 : 1 + size], self._held[1 + size]
            if crc8(body) != check:
                self._held = self._held[1:]
                continue
            self._held = self._held[2 + size :]
            yield body[0], body[1:]
