"""What is known of the vehicle at the other end: its clock, its settings, who else commands it."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from quad_mpc_ros.ros.bridges.mavlink.autopilots import SetpointEcho

_SECOND = 1_000_000_000
_MAX_REQUESTS = 10  # about a parameter, or about the time at once
_REQUEST_PERIOD_NS = 300_000_000
_MEMORY_NS = _SECOND  # of setpoints, which come back late
_MIN_HISTORY_NS = _SECOND // 2
_MAX_FOREIGN = 3  # targets of others, among ours, before that is no accident
_FAULT_HOLD_NS = 2 * _SECOND


class VehicleClock:
    """The vehicle's clock on ours, by TIMESYNC.

    The vehicle read its clock between question and answer. So every answer, also one that took
    long, bounds the offset from both sides, whatever the drift of a simulation's clock.
    """

    def __init__(self) -> None:
        self.offset_ns = 0
        """By how much it is behind ours; 0 while that is unknown."""
        self._is_known = False
        self._request_times: deque[int] = deque(maxlen=_MAX_REQUESTS)

    def note_request(self, *, now_ns: int) -> None:
        """Note that it is asked now."""
        self._request_times.append(now_ns)

    def receive(self, *, sent_ns: int, vehicle_ns: int, now_ns: int) -> None:
        """Take an answer, unless it answers no question of ours."""
        if sent_ns not in self._request_times or not 0 <= now_ns - sent_ns <= _SECOND:
            return
        least_ns, most_ns = sent_ns - vehicle_ns, now_ns - vehicle_ns
        middle_ns = (least_ns + most_ns) // 2
        if not self._is_known or abs(self.offset_ns - middle_ns) > _SECOND:
            self.offset_ns, self._is_known = middle_ns, True
        self.offset_ns = min(max(self.offset_ns, least_ns), most_ns)


class AutopilotParameters:
    """The vehicle's parameters that matter, as far as they were received."""

    def __init__(self, names: Sequence[str]) -> None:
        self.values: dict[str, float] = {}
        self._requests = dict.fromkeys(names, 0)
        self._requested_ns: int | None = None

    @property
    def are_complete(self) -> bool:
        """Whether each has come, or has been asked for in vain."""
        return all(
            name in self.values or count >= _MAX_REQUESTS for name, count in self._requests.items()
        )

    def due(self, *, now_ns: int) -> list[str]:
        """Return the names to ask for now."""
        before_ns = self._requested_ns
        if before_ns is not None and abs(now_ns - before_ns) < _REQUEST_PERIOD_NS:
            return []
        missing = [
            name
            for name, count in self._requests.items()
            if name not in self.values and count < _MAX_REQUESTS
        ]
        self._requested_ns = now_ns
        for name in missing:
            self._requests[name] += 1
        return missing

    def receive(self, name: str, value: float) -> bool:
        """Take a parameter; return whether it matters and is another than before."""
        if name not in self._requests or self.values.get(name) == value:
            return False
        self.values[name] = value
        return True


class OtherSetpointSources:
    """Whether the vehicle follows setpoints that were not sent here.

    An autopilot that has left the mode follows its own setpoints, and reports them before it
    reports the mode. So strange targets are a suspicion until a later report of the mode.
    """

    def __init__(self) -> None:
        self._sent: deque[tuple[int, SetpointEcho]] = deque()
        self._foreign_ns: deque[int] = deque(maxlen=_MAX_FOREIGN)  # when
        self._found: tuple[int, str] | None = None
        self.suspected = False
        """Whether a report of the mode is needed to decide."""

    def note_setpoint(self, setpoint: SetpointEcho, *, now_ns: int) -> None:
        """Note a setpoint of ours."""
        self._sent.append((now_ns, setpoint))
        while abs(now_ns - self._sent[0][0]) > _MEMORY_NS:
            self._sent.popleft()

    def receive_target(self, target: SetpointEcho, *, now_ns: int) -> None:
        """Take the target that the vehicle reports while it is ours."""
        recent = [each for sent_ns, each in self._sent if abs(now_ns - sent_ns) <= _MEMORY_NS]
        if not recent or now_ns - self._sent[0][0] < _MIN_HISTORY_NS:
            return
        if any(each.matches(target) for each in recent):
            return
        self._foreign_ns.append(now_ns)
        often = len(self._foreign_ns) == _MAX_FOREIGN
        if often and abs(now_ns - self._foreign_ns[0]) <= _FAULT_HOLD_NS:
            self.suspected = True

    def resolve(self, *, takes_setpoints: bool, now_ns: int) -> None:
        """Decide about a suspicion by the mode, which is reported now."""
        if not self.suspected:
            return
        if takes_setpoints:
            self.note_sender("it follows setpoints that were not sent here", now_ns=now_ns)
        self.suspected = False
        self._foreign_ns.clear()

    def note_sender(self, why: str, *, now_ns: int) -> None:
        """Note that another sender commands."""
        self._found = now_ns, why

    def fault(self, *, now_ns: int) -> str:
        """Return who else commands the vehicle, for some time after it was noticed, or nothing."""
        if self._found is None or abs(now_ns - self._found[0]) > _FAULT_HOLD_NS:
            return ""
        return f"another sender commands the vehicle as well: {self._found[1]}"
