"""What leads the controller around obstacles, as the controller sees it.

It is no part of the controller, which knows nothing of obstacles: it is asked in each tick.
"""

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
    """What is flown in place of the reference, and why.

    ``state`` is free (the reference), around, or stopped; failed if the guide raised an error, off
    without a guide. ``clearance`` [m] is from the vehicle's surface to the nearest known
    obstacle's, infinity where none is near.
    """

    state: str = "off"
    reason: str = ""
    clearance: float = float("inf")


class Guided(NamedTuple):
    """The window to be flown and where the vehicle may be, None for anywhere."""

    window: ReferenceWindow
    corridor: Corridor | None = None
    avoidance: Avoidance = Avoidance()


class Guide(Stage, ABC):
    """Leads around what is in the way.

    Where the reference keeps clear the window is the one that was given, without a corridor: the
    commands are then the same as without a guide. A guide may raise: in that step the reference is
    flown, without a corridor. It is asked again in the next one, with its state as it left it.
    """

    @abstractmethod
    def guide(
        self, odometry: OdometrySample, window: ReferenceWindow, plan: Plan | None
    ) -> Guided:
        """Return what to fly from an odometry on, given the last plan."""
