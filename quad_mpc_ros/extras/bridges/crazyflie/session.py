# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Preparation of the firmware, and its telemetry.

The legacy setpoint contains rates only if three parameters are set, again after each restart. Log
variables are requested by number, so names are read one by one until the required variables are
found.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field

from quad_mpc_ros.extras.bridges import crtp
from quad_mpc_ros.ros.bridges.handover import is_old

_RATE_MODES = tuple(f"flightmode.stabMode{axis}" for axis in ("Roll", "Pitch", "Yaw"))
_STATE, _VOLTAGE = "supervisor.info", "pm.vbat"
_LOG_VARIABLES = (_STATE, _VOLTAGE)
_LOG_BLOCK = 1
_LOG_PERIOD = 0.1  # s
_RETRY_NS = 200_000_000
_MAX_PENDING = 4  # pending requests: the firmware's queues would lose more
_SESSION_TIMEOUT_NS = 1_000_000_000  # then the firmware was restarted, or is out of reach


@dataclass(kw_only=True)
class CrazyflieTelemetry:
    """Telemetry of the firmware; ``info`` are bits of the supervisor."""

    received_ns: int | None = None
    info: int = 0
    voltage: float = 0.0
    takes_rates: bool = False
    faults: list[str] = field(default_factory=list)


@dataclass(kw_only=True)
class _Preparation:
    """Progress of the preparation: unset modes, found variables, pending requests with times."""

    unset: set[str] = field(default_factory=lambda: set(_RATE_MODES))
    count: int | None = None
    variables: dict[str, crtp.LogVariable] = field(default_factory=dict)
    block: tuple[crtp.LogVariable, ...] = ()
    seen: set[int] = field(default_factory=set)
    asked_ns: dict[int, int] = field(default_factory=dict)
    due_ns: dict[str, int] = field(default_factory=dict)

    @property
    def is_searched(self) -> bool:
        """Whether all variables were found or read."""
        found = all(name in self.variables for name in _LOG_VARIABLES)
        return found or (self.count is not None and len(self.seen) >= self.count)

    def questions(self, now_ns: int) -> Iterator[crtp.Packet]:
        """Request unknown names, a few at a time."""
        late = [n for n, asked_ns in self.asked_ns.items() if abs(now_ns - asked_ns) > _RETRY_NS]
        new = (n for n in range(self.count or 0) if n not in self.seen and n not in self.asked_ns)
        room = max(_MAX_PENDING - len(self.asked_ns), 0)
        for number in (*late, *itertools.islice(new, room)):
            self.asked_ns[number] = now_ns
            yield crtp.log_variable_request(number)


class Session:
    """Prepares a Crazyflie, again after each silence."""

    def __init__(self) -> None:
        self.telemetry = CrazyflieTelemetry()
        self._progress = _Preparation()

    def receive(self, packet: crtp.Packet, *, now_ns: int) -> None:
        """Receive a packet from the firmware."""
        progress = self._progress
        for name in _RATE_MODES:
            error = crtp.parameter_answer(packet, name)
            if error is not None:
                self._on_parameter(name, error)
        count = crtp.log_count(packet)
        if count is not None:
            progress.count = count
        variable = crtp.log_variable(packet)
        if variable is not None and variable.number < (progress.count or 0):
            progress.asked_ns.pop(variable.number, None)
            progress.seen.add(variable.number)
            if variable.name in _LOG_VARIABLES:
                progress.variables[variable.name] = variable
        values = crtp.logged(packet, _LOG_BLOCK, progress.block)
        if values:
            telemetry = self.telemetry
            telemetry.received_ns = now_ns
            telemetry.info = int(values.get(_STATE, 0.0))
            telemetry.voltage = values.get(_VOLTAGE, 0.0)

    def requests(self, *, now_ns: int) -> Iterator[crtp.Packet]:
        """Yield the requests that are due."""
        received_ns = self.telemetry.received_ns
        if received_ns is not None and is_old(received_ns, now_ns, _SESSION_TIMEOUT_NS):
            self.telemetry.received_ns, self.telemetry.takes_rates = None, False
            self._progress = _Preparation()
        progress = self._progress
        if progress.unset and self._due("modes", now_ns):
            for name in _RATE_MODES:
                if name in progress.unset:
                    yield crtp.set_parameter(name, 0)
        if progress.count is None:
            if self._due("count", now_ns):
                yield crtp.log_reset()
                yield crtp.log_count_request()
        elif not progress.is_searched:
            yield from progress.questions(now_ns)
        elif is_old(self.telemetry.received_ns, now_ns, _SESSION_TIMEOUT_NS // 2) and self._due(
            "block", now_ns
        ):
            yield from self._start_of_log()

    def _on_parameter(self, name: str, error: int) -> None:
        if error:
            self.telemetry.faults.append(f"the Crazyflie refuses to set {name}: error {error}")
        else:
            self._progress.unset.discard(name)
            self.telemetry.takes_rates = not self._progress.unset

    def _start_of_log(self) -> Iterator[crtp.Packet]:
        if _STATE not in self._progress.variables:
            self.telemetry.faults.append(f"update the firmware: no log variable {_STATE}")
            return
        self._progress.block = tuple(self._progress.variables.values())
        yield crtp.log_block(_LOG_BLOCK, self._progress.block)
        yield crtp.log_start(_LOG_BLOCK, period=_LOG_PERIOD)

    def _due(self, what: str, now_ns: int) -> bool:
        before_ns = self._progress.due_ns.get(what)
        if before_ns is not None and abs(now_ns - before_ns) < _RETRY_NS:
            return False
        self._progress.due_ns[what] = now_ns
        return True
