# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Clock and parameters of the connected vehicle, and other sources of setpoints."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from quad_mpc_ros.ros.bridges.mavlink.autopilots import SetpointEcho

_SECOND = 1_000_000_000
_MAX_REQUESTS = 10  # for a parameter; or pending requests for the time
_MEMORY_NS = _SECOND  # of sent setpoints: the autopilot reports them late
_MIN_HISTORY_NS = _SECOND // 2
_MAX_FOREIGN = 3  # reported targets that were not sent here, until they are suspicious
_FAULT_HOLD_NS = 2 * _SECOND


class VehicleClock:
    """Offset of the vehicle's clock, measured with TIMESYNC.

    The vehicle reads its clock between request and response. So every response, even a late one,
    bounds the offset from both sides, for any drift of the clocks.
    """

    def __init__(self) -> None:
        self.offset_ns = 0
        """Node's clock minus vehicle's clock; 0 while unknown."""
        self._is_known = False
        self._request_times: deque[int] = deque(maxlen=_MAX_REQUESTS)

    def note_request(self, *, now_ns: int) -> None:
        """Record that a request is sent now."""
        self._request_times.append(now_ns)

    def receive(self, *, sent_ns: int, vehicle_ns: int, now_ns: int) -> None:
        """Process a response, unless it has no matching request."""
        if sent_ns not in self._request_times or not 0 <= now_ns - sent_ns <= _SECOND:
            return
        least_ns, most_ns = sent_ns - vehicle_ns, now_ns - vehicle_ns
        middle_ns = (least_ns + most_ns) // 2
        if not self._is_known or abs(self.offset_ns - middle_ns) > _SECOND:
            self.offset_ns, self._is_known = middle_ns, True
        self.offset_ns = min(max(self.offset_ns, least_ns), most_ns)


class AutopilotParameters:
    """The required parameters of the autopilot, as far as received."""

    def __init__(self, names: Sequence[str]) -> None:
        self.values: dict[str, float] = {}
        self._requests = dict.fromkeys(names, 0)

    @property
    def are_complete(self) -> bool:
        """Whether each parameter was received, or requested often enough without response."""
        return not self._missing()

    def take_due(self) -> list[str]:
        """Return the names to request now; call this periodically."""
        missing = self._missing()
        for name in missing:
            self._requests[name] += 1
        return missing

    def _missing(self) -> list[str]:
        return [
            name
            for name, count in self._requests.items()
            if name not in self.values and count < _MAX_REQUESTS
        ]

    def receive(self, name: str, value: float) -> bool:
        """Store a parameter; return whether it is required and has changed."""
        if name not in self._requests or self.values.get(name) == value:
            return False
        self.values[name] = value
        return True


class OtherSetpointSources:
    """Detects that the vehicle follows setpoints of another sender.

    An autopilot that has left the setpoint mode follows its own setpoints, and reports these
    before its mode. So foreign targets are only a suspicion until the next report of the mode.
    """

    def __init__(self) -> None:
        self._sent: deque[tuple[int, SetpointEcho]] = deque()
        self._foreign_ns: deque[int] = deque(maxlen=_MAX_FOREIGN)  # when
        self._found: tuple[int, str] | None = None
        self.suspected = False
        """Whether a report of the mode is needed for the decision."""

    def note_setpoint(self, setpoint: SetpointEcho, *, now_ns: int) -> None:
        """Record a sent setpoint."""
        self._sent.append((now_ns, setpoint))
        while abs(now_ns - self._sent[0][0]) > _MEMORY_NS:
            self._sent.popleft()

    def receive_target(self, target: SetpointEcho, *, now_ns: int) -> None:
        """Compare a target reported by the engaged vehicle with the sent setpoints."""
        recent = [each for sent_ns, each in self._sent if abs(now_ns - sent_ns) <= _MEMORY_NS]
        if not recent or now_ns - self._sent[0][0] < _MIN_HISTORY_NS:
            return
        if np.isclose(recent, target, rtol=1e-5, atol=1e-5).all(axis=1).any():
            return
        self._foreign_ns.append(now_ns)
        often = len(self._foreign_ns) == _MAX_FOREIGN
        if often and abs(now_ns - self._foreign_ns[0]) <= _FAULT_HOLD_NS:
            self.suspected = True

    def resolve(self, *, takes_setpoints: bool, now_ns: int) -> None:
        """Decide a suspicion with the currently reported mode."""
        if not self.suspected:
            return
        if takes_setpoints:
            self.note_sender("the vehicle follows setpoints of another sender", now_ns=now_ns)
        self.suspected = False
        self._foreign_ns.clear()

    def note_sender(self, why: str, *, now_ns: int) -> None:
        """Record that another sender sends setpoints."""
        self._found = now_ns, why

    def fault(self, *, now_ns: int) -> str:
        """Return an error with the other sender, for some time after its detection."""
        if self._found is None or abs(now_ns - self._found[0]) > _FAULT_HOLD_NS:
            return ""
        return f"another sender commands the vehicle as well: {self._found[1]}"
