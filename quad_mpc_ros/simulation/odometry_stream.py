"""The odometries of a flight: measured on time, sent after their delay."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from quad_mpc_ros.model.samples import OdometrySample
from quad_mpc_ros.simulation.config import SimulatorConfig
from quad_mpc_ros.simulation.plant import Plant
from quad_mpc_ros.simulation.sensors import Sensors, odometry_stamps


@dataclass(frozen=True, kw_only=True, eq=False)
class SentOdometry:
    """An odometry and when it is sent, from the start of the plant; ``truth`` is without error."""

    time_ns: int
    odometry: OdometrySample
    truth: OdometrySample


class OdometryStream:
    """Moves the plant through time and measures it on the way.

    A measurement at the time at which a command arrives does not yet see the command. What is
    lost is measured but never sent.
    """

    def __init__(self, plant: Plant, config: SimulatorConfig, *, start_stamp_ns: int) -> None:
        self._plant = plant
        self._sensors = Sensors(config)
        self._start_stamp_ns = start_stamp_ns
        self._delay_ns = round(config.odom_delay * 1e9)
        self._period_ns = round(1e9 / config.odom_rate)
        self._times = odometry_stamps(config)
        self._next_ns = next(self._times, None)
        self._waiting: deque[SentOdometry] = deque()
        self._end_ns = 0

    def step(self) -> SentOdometry | None:
        """Move the plant to the next sending; None when there is none any more."""
        while not self._waiting or self._measures_by(self._waiting[0].time_ns):
            if self._next_ns is None:
                return None
            self._measure()
        sent = self._waiting.popleft()
        self._plant.advance_to(sent.time_ns)
        return sent

    def advance_to(self, time_ns: int) -> list[SentOdometry]:
        """Move the plant to a time and return what is to be sent by then."""
        while self._measures_by(time_ns):
            self._measure()
        self._plant.advance_to(time_ns)
        due = []
        while self._waiting and self._waiting[0].time_ns <= time_ns:
            due.append(self._waiting.popleft())
        return due

    def ended(self, time_ns: int) -> bool:
        """Whether the last odometry was sent a period ago or more."""
        return self._next_ns is None and not self._waiting and time_ns >= self._end_ns

    def _measures_by(self, time_ns: int) -> bool:
        return self._next_ns is not None and self._next_ns <= time_ns

    def _measure(self) -> None:
        assert self._next_ns is not None
        self._plant.advance_to(self._next_ns)
        truth = self._plant.odometry(self._start_stamp_ns + self._next_ns)
        odometry = self._sensors.measured(truth)
        time_ns = self._next_ns + self._delay_ns
        if not self._sensors.lost():
            self._waiting.append(SentOdometry(time_ns=time_ns, odometry=odometry, truth=truth))
        self._end_ns = time_ns + self._period_ns
        self._next_ns = next(self._times, None)
