"""Model errors of a rehearsal, and the margins that are needed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from quad_mpc_ros.simulation.config import SimulatorConfig

_LAG_TEXT = (
    "measure lags and delay with quad_mpc identify (docs/howto/identify.md), use the weights of "
    "default, or raise R of the body rates (docs/howto/tune.md)"
)
_MASS_TEXT = "weigh the vehicle, and set thrust_curve from a thrust stand or its hover throttle"


@dataclass(frozen=True, kw_only=True)
class Direction:
    """A difference between the simulated and the configured vehicle.

    Attributes:
        name: Name in tables.
        parameter: Parameter of the simulator that changes.
        change: ``plus`` adds the difference, ``times`` scales by 1 plus the difference.
        sign: Sign of the difference.
        most: Largest difference, in s or as a share.
        ready: Margin needed to be ready to fly.
        marginal: Smallest margin for a careful flight.
        advice: Remedy for a margin that is too small.
    """

    name: str
    parameter: str
    change: Literal["plus", "times"]
    sign: float = 1.0
    most: float
    ready: float
    marginal: float
    advice: str

    def changed(self, nominal: Any, by: float) -> Any:
        """Return the parameter of a vehicle with a difference."""
        if self.change == "times":
            return nominal * (1.0 + self.sign * by)
        if isinstance(nominal, tuple):
            return [max(each + self.sign * by, 0.0) for each in nominal]
        return max(nominal + self.sign * by, 0.0)

    def text(self, by: float) -> str:
        """Return a difference with its unit."""
        return f"{1e3 * by:.0f} ms" if self.change == "plus" else f"{100.0 * by:.0f} %"


def _later(name: str, parameter: str) -> Direction:
    return Direction(
        name=name,
        parameter=parameter,
        change="plus",
        most=0.2,
        ready=0.04,
        marginal=0.015,
        advice=_LAG_TEXT,
    )


def _scaled(name: str, parameter: str, *, sign: float = 1.0) -> Direction:
    return Direction(
        name=name,
        parameter=parameter,
        change="times",
        sign=sign,
        most=0.6,
        ready=0.2,
        marginal=0.1,
        advice=_MASS_TEXT,
    )


_DIRECTIONS = (
    _later("body rates lag more", "rate_time_constant"),
    _later("thrust lags more", "thrust_time_constant"),
    _later("delay is longer", "command_delay"),
    _scaled("thrust is less", "thrust_scale", sign=-1.0),
    _scaled("thrust is more", "thrust_scale"),
    _scaled("mass is more", "mass_scale"),
)


def directions_of(simulator: SimulatorConfig) -> list[Direction]:
    """Return the possible differences of a simulated vehicle.

    Plants with their own lags have no parameters for them. A modelled delay may also be shorter.
    """
    own = simulator.entry().has_own
    found = [each for each in _DIRECTIONS if each.parameter not in own]
    delay = simulator.command_delay
    if delay > 0.0:
        shorter = Direction(
            name="delay is shorter",
            parameter="command_delay",
            change="plus",
            sign=-1.0,
            most=delay,
            ready=min(0.04, delay),
            marginal=min(0.015, delay),
            advice="configure a shorter input_delay (docs/tutorials/first_flight.md)",
        )
        found.insert(len(found) - 3, shorter)
    return found
