"""The states of a vehicle and the ground, and what leads from one to another.

One :class:`~.ground_detector.GroundDetector` follows the table; all others ask it, in its process
or on the topic ``mpc/ground_state``. ``docs/explanation/landing_detection.md`` shows the table.
"""

from __future__ import annotations

import enum
from collections.abc import Collection
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.control.model.samples import ReferenceWindow

NO_LIFT = 0.4
"""Thrust as a share of the weight: with no more no vehicle lifts off, or stays in the air."""
HEIGHT = 0.1
"""Difference [m] from the vehicle at which a reference asks it to climb or to sink."""
LEFT_GROUND = 0.15
"""Distance [m] from where it stood, beyond which a vehicle under thrust flies."""
LEFT_GROUND_UNPOWERED = 2.0 * LEFT_GROUND
"""The same where the thrust is not known, so that a drifting estimate must not do."""


class GroundState(enum.Enum):
    """Whether the vehicle stands or flies."""

    UNKNOWN = "unknown"
    ON_GROUND = "on_ground"
    LIFTING_OFF = "lifting_off"
    FLYING = "flying"
    TOUCHING_DOWN = "touching_down"
    CRASHED = "crashed"

    def __init__(self, name: str) -> None:
        self.stands = name in ("on_ground", "lifting_off")
        """Whether it is certain that it stands, be it that it is about to lift off."""
        self.flies = name in ("flying", "touching_down")
        """Whether it is certain that it flies, be it that it may just have come down."""


class GroundEvidence(enum.Enum):
    """What leads from one state to another; the value is what it is in words."""

    LIES = "it keeps a height that it could not keep in the air: upside down, or after a collision"
    LEFT = "it has left its place under thrust, moves, or has had lifting thrust for long"
    RESTS = "it keeps its height with so little thrust that it would fall"
    CLIMBS = "the reference climbs, or is above the vehicle"
    TOUCHES = "the reference sinks, and it is slow and carried, low with little thrust, or to idle"


class Transition(NamedTuple):
    """From ``state`` to ``then`` when there is evidence, or when there is none any more."""

    state: GroundState
    evidence: GroundEvidence
    present: bool
    then: GroundState


_UNKNOWN, _ON_GROUND, _LIFTING_OFF, _FLYING, _TOUCHING_DOWN, _CRASHED = GroundState

TRANSITIONS = (
    Transition(_UNKNOWN, GroundEvidence.LIES, True, _CRASHED),
    Transition(_UNKNOWN, GroundEvidence.LEFT, True, _FLYING),
    Transition(_UNKNOWN, GroundEvidence.RESTS, True, _ON_GROUND),
    Transition(_ON_GROUND, GroundEvidence.LIES, True, _CRASHED),
    Transition(_ON_GROUND, GroundEvidence.LEFT, True, _FLYING),
    Transition(_ON_GROUND, GroundEvidence.CLIMBS, True, _LIFTING_OFF),
    Transition(_LIFTING_OFF, GroundEvidence.LIES, True, _CRASHED),
    Transition(_LIFTING_OFF, GroundEvidence.LEFT, True, _FLYING),
    Transition(_LIFTING_OFF, GroundEvidence.CLIMBS, False, _ON_GROUND),
    Transition(_FLYING, GroundEvidence.LIES, True, _CRASHED),
    Transition(_FLYING, GroundEvidence.RESTS, True, _ON_GROUND),
    Transition(_FLYING, GroundEvidence.TOUCHES, True, _TOUCHING_DOWN),
    Transition(_TOUCHING_DOWN, GroundEvidence.LIES, True, _CRASHED),
    Transition(_TOUCHING_DOWN, GroundEvidence.RESTS, True, _ON_GROUND),
    Transition(_TOUCHING_DOWN, GroundEvidence.TOUCHES, False, _FLYING),
    Transition(_CRASHED, GroundEvidence.LIES, False, _FLYING),
)
"""Of those from a state the first that applies is taken, at most one at an odometry.

Commands that begin or cease to act lead to ``UNKNOWN``, or to ``ON_GROUND`` where the flight stack
reports to have landed.
"""


def next_state(state: GroundState, evidence: Collection[GroundEvidence]) -> GroundState:
    """Return the state that follows from what there is evidence of."""
    for before, kind, present, then in TRANSITIONS:
        if before is state and (kind in evidence) is present:
            return then
    return state


class AllowedCommand(enum.Enum):
    """What of a command goes to the motors."""

    IDLE = "motors idle, no rates"
    LEVEL = "throttle, and rates that make it level"
    ALL = "throttle and rates"


class Learning(enum.Enum):
    """What the estimator may do with an odometry."""

    HOLD = "hold what was learned"
    PAUSE = "follow the velocity, learn nothing"
    LEARN = "learn"


def idling(window: ReferenceWindow, gravity: float) -> ReferenceWindow:
    """Return a window at rest that asks for idle motors: its acceleration is that of free fall.

    So the force that it asks for is none, and what keeps the vehicle at rest is the ground.
    """
    return replace(window, a_WB_W=np.tile([0.0, 0.0, -gravity], (len(window.offset_ns), 1)))


def idles(window: ReferenceWindow, gravity: float) -> bool:
    """Whether a window asks for idle motors: at rest with less force than any vehicle flies by."""
    if window.v_WB_W.any():
        return False
    force = np.linalg.norm(window.a_WB_W + np.array([0.0, 0.0, gravity]), axis=1)
    return bool(np.all(force < NO_LIFT * gravity))


class StandingHeight:
    """The height [m] at which a vehicle stood last, and whether it has left it since.

    The rule of who has neither the detector's state nor the flight stack's flag.
    """

    def __init__(self, threshold: float) -> None:
        """Begin without a height; beyond the ``threshold`` [m] it has been left."""
        self._threshold = threshold
        self.height: float | None = None
        self.left = False

    def stand(self, height: float) -> None:
        """Take a height at which it stands."""
        self.height, self.left = height, False

    def see(self, height: float) -> None:
        """Take a height at which it may stand."""
        if self.height is not None:
            self.left = self.left or abs(height - self.height) > self._threshold
