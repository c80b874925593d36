# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""MSP over the serial line: sticks out, telemetry in."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

from quad_mpc_ros.extras.bridges.betaflight.rates import RateCurve
from quad_mpc_ros.messages import msp

T = TypeVar("T")

_MILLISECOND = 1_000_000

# Modes by their permanent numbers.
ARM, ANGLE, HORIZON, FAILSAFE, MSP_OVERRIDE = 0, 1, 2, 27, 50

_RATES_TYPES = ("BETAFLIGHT", "RACEFLIGHT", "KISS", "ACTUAL", "QUICK")

# The flags that prevent arming, from the lowest bit on.
_ARMING_DISABLE_FLAGS = (
    *("NOGYRO", "FAILSAFE", "RXLOSS", "NOT_DISARMED", "BOXFAILSAFE", "RUNAWAY", "CRASH"),
    *("THROTTLE", "ANGLE", "BOOTGRACE", "NOPREARM", "LOAD", "CALIB", "CLI", "CMS", "BST", "MSP"),
    *("PARALYZE", "GPS", "RESCUE_SW", "DSHOT_TELEM", "REBOOT_REQD", "DSHOT_BBANG", "NO_ACC_CAL"),
    *("MOTOR_PROTO", "FLIP_SWITCH", "ALT_HOLD_SW", "POS_HOLD_SW", "ARM_SWITCH"),
)


@dataclass(kw_only=True)
class BetaflightTelemetry:
    """Telemetry of the flight controller, with the times of state and attitude.

    ``roll`` and ``pitch`` [rad] are about body x and y (FLU). ``modes`` are the active modes,
    ``blocks`` the reasons that prevent arming. ``curves`` are rate curves (roll, pitch, yaw).
    """

    state_ns: int | None = None
    modes: frozenset[int] = frozenset()
    blocks: tuple[str, ...] = ()
    attitude_ns: int | None = None
    roll: float = 0.0
    pitch: float = 0.0
    voltage: float = 0.0
    curves: tuple[RateCurve, ...] = ()
    faults: list[str] = field(default_factory=list)


class MspProtocol:
    """Requests modes and rates first, then state, attitude and voltage."""

    _BOXIDS, _STATUS, _ATTITUDE, _ANALOG, _RC_TUNING = 119, 101, 108, 110, 111

    def __init__(self, telemetry: BetaflightTelemetry) -> None:
        self._telemetry = telemetry
        self._reader = msp.MspReader()
        self._boxes: bytes = b""
        self._asked_ns: dict[int, int] = {}
        self._answers = {
            self._BOXIDS: self._on_boxes,
            self._STATUS: self._on_status,
            self._ATTITUDE: self._on_attitude,
            self._ANALOG: self._on_analog,
            self._RC_TUNING: self._on_rc_tuning,
        }

    def sticks(self, pulses: Sequence[float]) -> bytes:
        """Return the frame of the channels [us], in whole microseconds."""
        return msp.raw_rc(tuple(map(round, pulses)))

    def requests(self, *, now_ns: int) -> bytes:
        """Return the requests that are due."""
        periods = {self._STATUS: 40, self._ATTITUDE: 40, self._ANALOG: 1000, self._RC_TUNING: 1000}
        if not self._boxes:
            periods = {self._BOXIDS: 200}
        if not self._telemetry.curves:
            periods[self._RC_TUNING] = 200
        asked = b""
        for command, period in periods.items():
            before_ns = self._asked_ns.get(command)
            if before_ns is None or abs(now_ns - before_ns) >= period * _MILLISECOND:
                self._asked_ns[command] = now_ns
                asked += msp.request(command)
        return asked

    def receive(self, data: bytes, *, now_ns: int) -> None:
        """Receive answers, in pieces of any length."""
        for answer in self._reader.read(data):
            take = self._answers.get(answer.command)
            if take is None or answer.refused:
                continue
            try:
                take(answer.payload, now_ns)
            except (struct.error, IndexError):
                self._telemetry.faults.append(f"MSP: answer to {answer.command} is too short")

    def _on_boxes(self, payload: bytes, now_ns: int) -> None:
        self._boxes = payload

    def _on_status(self, payload: bytes, now_ns: int) -> None:
        if not self._boxes:
            return
        (flags,) = struct.unpack_from("<I", payload, 6)
        more = payload[15] & 0xF
        flags |= int.from_bytes(payload[16 : 16 + more], "little") << 32
        (blocks,) = struct.unpack_from("<I", payload, 17 + more)
        telemetry = self._telemetry
        telemetry.modes = frozenset(_flagged(self._boxes, flags))
        telemetry.blocks = tuple(_flagged(_ARMING_DISABLE_FLAGS, blocks))
        telemetry.state_ns = now_ns

    def _on_attitude(self, payload: bytes, now_ns: int) -> None:
        roll, pitch = struct.unpack_from("<hh", payload)
        telemetry = self._telemetry
        telemetry.roll, telemetry.pitch = math.radians(0.1 * roll), math.radians(0.1 * pitch)
        telemetry.attitude_ns = now_ns

    def _on_analog(self, payload: bytes, now_ns: int) -> None:
        (hundredths,) = struct.unpack_from("<H", payload, 7)
        self._telemetry.voltage = 0.01 * hundredths

    def _on_rc_tuning(self, payload: bytes, now_ns: int) -> None:
        roll_rate, roll_expo, *super_rates = payload[0:5]
        yaw_expo, yaw_rate, pitch_rate, pitch_expo = payload[10:14]
        limits = struct.unpack_from("<3H", payload, 16)
        kind = payload[22]
        name = _RATES_TYPES[kind] if kind < len(_RATES_TYPES) else str(kind)
        rates, expos = (roll_rate, pitch_rate, yaw_rate), (roll_expo, pitch_expo, yaw_expo)
        self._telemetry.curves = tuple(
            RateCurve(kind=name, rc_rate=rate, super_rate=super_rate, expo=expo, limit=limit)
            for rate, super_rate, expo, limit in zip(
                rates, super_rates, expos, limits, strict=True
            )
        )


def _flagged(values: Iterable[T], flags: int) -> Iterator[T]:
    """Return the values whose bit is set in the flags."""
    return (value for bit, value in enumerate(values) if flags >> bit & 1)
