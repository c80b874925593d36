"""Which plant flies."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from quad_mpc_ros.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.model.state import State
from quad_mpc_ros.simulation.config import SimulatorConfig
from quad_mpc_ros.simulation.plant import Plant
from quad_mpc_ros.simulation.rotorpy_plant import RotorpyPlant


class AnyPlant(Protocol):
    """A vehicle that commands move through time, in nanoseconds from its start."""

    @property
    def time_ns(self) -> int:
        """Time of the state."""
        ...

    @property
    def state(self) -> State:
        """The true state."""
        ...

    def apply(self, command: CommandSample) -> None:
        """Take a command that arrives now."""
        ...

    def advance_to(self, time_ns: int) -> None:
        """Move to a time; a time already past changes nothing."""
        ...

    def odometry(self, stamp_ns: int) -> OdometrySample:
        """Return the true odometry under a stamp."""
        ...


PLANTS: dict[str, Callable[[SimulatorConfig], AnyPlant]] = {
    "internal": Plant,
    "rotorpy": RotorpyPlant,
}


def make_plant(config: SimulatorConfig) -> AnyPlant:
    """Return the configured plant at its start.

    Raises :class:`UserError` when what it needs is not installed.
    """
    return PLANTS[config.plant](config)
