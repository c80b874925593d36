"""What a plant is, and what most plants have in common: time, late commands, moving air."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Protocol

from quad_mpc_ros.lie import Array
from quad_mpc_ros.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.model.state import Input
from quad_mpc_ros.simulation.actuators import CommandDelay, input_from_command
from quad_mpc_ros.simulation.parameters import PlantParameters
from quad_mpc_ros.simulation.wind import Wind


class Plant(Protocol):
    """A vehicle that commands move through time, in nanoseconds from its start."""

    def apply(self, command: CommandSample) -> None:
        """Take a command that arrives now."""
        ...

    def advance_to(self, time_ns: int) -> None:
        """Move to a time; a time already past changes nothing."""
        ...

    def odometry(self, stamp_ns: int) -> OdometrySample:
        """Return the true odometry under a stamp."""
        ...


class DelayedPlant(ABC):
    """A plant whose commands act after a delay, in wind and gusts.

    Derived classes integrate: :meth:`_integrate` and :meth:`_follow`. No step of theirs goes
    beyond where a command begins to act or where the gusts change.
    """

    def __init__(self, config: PlantParameters) -> None:
        self._vehicle = config.vehicle()
        self._delay = CommandDelay(config.command_delay)
        self._wind = Wind(config)
        self._time_ns = 0

    @property
    @abstractmethod
    def v_WB_W(self) -> Array:
        """True velocity (3,) [m/s]."""

    @abstractmethod
    def _follow(self, command: Input) -> None:
        """Follow a command from now on."""

    @abstractmethod
    def _integrate(self, duration_ns: int) -> None:
        """Move the state by a time in which neither command nor wind changes."""

    @property
    def time_ns(self) -> int:
        """Time of the state, from the start of the plant."""
        return self._time_ns

    @property
    def wind_W(self) -> Array:
        """Velocity of the air (3,) [m/s]."""
        return self._wind.velocity_W

    def apply(self, command: CommandSample) -> None:
        """Take a command that arrives now. The throttle saturates; nonsense is ignored."""
        u = input_from_command(command)
        if u is not None:
            self._delay.put(u, time_ns=self._time_ns)
            self._follow_commands()

    def advance_to(self, time_ns: int) -> None:
        """Integrate to a time; a time already past changes nothing."""
        while self._time_ns < time_ns:
            until_ns = min(time_ns, self._delay.next_ns, self._wind.next_ns)
            self._integrate(until_ns - self._time_ns)
            self._time_ns = until_ns
            self._follow_commands()
            if self._wind.next_ns <= until_ns:
                self._wind.advance_to(until_ns, v_WB_W=self.v_WB_W)

    def _follow_commands(self) -> None:
        command = self._delay.take(time_ns=self._time_ns)
        if command is not None:
            self._follow(command)
