"""The interface of guides, which change the reference for obstacles or gates in each tick."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.control.ocp.plan import Plan
from quad_mpc_ros.control.stage import Stage

FAILED = "failed"
"""State of avoidance when the guide raised an error."""


class Avoidance(NamedTuple):
    """State of the avoidance and its reason.

    ``state`` is free (the reference is flown), around, or stopped; failed if the guide raised an
    error, off without a guide. ``clearance`` [m] is between the surfaces of the vehicle and the
    nearest known obstacle, infinity if no obstacle is near.
    """

    state: str = "off"
    reason: str = ""
    clearance: float = float("inf")


class Guided(NamedTuple):
    """The window to fly, and the free region, None for no constraint."""

    window: ReferenceWindow
    corridor: Corridor | None = None
    avoidance: Avoidance = Avoidance()


class Guide(Stage, ABC):
    """Changes the reference to avoid obstacles.

    If the reference is free, the guide returns the unchanged window without a corridor, so that
    the commands equal those without a guide. If a guide raises, the reference is flown without a
    corridor in that step; the next step calls the guide again.
    """

    @abstractmethod
    def guide(
        self, odometry: OdometrySample, window: ReferenceWindow, plan: Plan | None
    ) -> Guided:
        """Return the window and corridor to fly from an odometry on; ``plan`` is the last plan."""
