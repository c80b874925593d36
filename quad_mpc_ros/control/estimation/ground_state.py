# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The ground states and their transitions.

:class:`~.ground_detector.GroundDetector` applies the table and publishes the state on
``mpc/ground_state``. ``docs/explanation/landing_detection.md`` shows the table.
"""

from __future__ import annotations

import enum
from collections.abc import Collection
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.control.model.samples import ReferenceWindow

NO_LIFT = 0.4
"""Thrust as a share of the weight, too low to lift off or to stay in the air."""
HEIGHT = 0.1
"""Difference in height [m] between reference and vehicle that commands a climb or descent."""
LEFT_GROUND = 0.15
"""Distance [m] from the position on the ground beyond which a vehicle under thrust flies."""
LEFT_GROUND_UNPOWERED = 2.0 * LEFT_GROUND
"""Corresponding distance if the thrust is unknown: larger, as the estimate drifts."""


class GroundState(enum.Enum):
    """Whether the vehicle is on the ground or flies."""

    UNKNOWN = "unknown"
    ON_GROUND = "on_ground"
    LIFTING_OFF = "lifting_off"
    FLYING = "flying"
    TOUCHING_DOWN = "touching_down"
    CRASHED = "crashed"

    def __init__(self, name: str) -> None:
        self.is_on_ground = name in ("on_ground", "lifting_off")
        """Whether the vehicle is certainly on the ground, possibly about to lift off."""
        self.is_flying = name in ("flying", "touching_down")
        """Whether the vehicle certainly flies, possibly about to touch down."""


class GroundEvidence(enum.Enum):
    """Evidence for a transition; the value describes it."""

    LIES = "the vehicle does not fall, although inverted, or climb with thrust after a collision"
    LEFT = (
        "the vehicle moves, left its position under thrust, or had lift-off thrust for some time"
    )
    RESTS = "the vehicle holds its height with too little thrust to fly"
    CLIMBS = "the reference climbs, or is above the vehicle"
    TOUCHES = "the reference sinks; the slow vehicle is carried, low, idle or has met the ground"


class Transition(NamedTuple):
    """From ``state`` to ``then`` if the evidence is ``present``, or absent."""

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
"""The first matching row is applied, at most one per odometry.

When the vehicle starts or stops executing commands, the state becomes ``UNKNOWN``, or
``ON_GROUND`` if the flight stack reports a landing.
"""


def next_state(state: GroundState, evidence: Collection[GroundEvidence]) -> GroundState:
    """Return the state that follows from the evidence."""
    for before, kind, present, then in TRANSITIONS:
        if before is state and (kind in evidence) is present:
            return then
    return state


class AllowedCommand(enum.Enum):
    """The part of a command that is sent to the motors."""

    IDLE = "motors idle, no rates"
    LEVEL = "throttle, and rates that level the vehicle"
    ALL = "throttle and rates"


def idling(window: ReferenceWindow, gravity: float) -> ReferenceWindow:
    """Return a window at rest that requests idle motors by the acceleration of free fall."""
    return replace(window, a_WB_W=np.tile([0.0, 0.0, -gravity], (len(window.offset_ns), 1)))


def idles(window: ReferenceWindow, gravity: float) -> bool:
    """Whether a window requests idle motors: at rest, with less force than any flight requires."""
    if np.count_nonzero(window.v_WB_W):
        return False
    force = np.linalg.norm(window.a_WB_W + np.array([0.0, 0.0, gravity]), axis=1)
    return bool(np.all(force < NO_LIFT * gravity))


class GroundHeight:
    """The last height [m] on the ground, and whether the vehicle has left it since.

    For use without ground state and without a landed flag of the flight stack.
    """

    def __init__(self, threshold: float) -> None:
        """Beyond the ``threshold`` [m] the vehicle has left the ground."""
        self._threshold = threshold
        self.height: float | None = None
        self.was_left = False

    def set(self, height: float) -> None:
        """Set the height of a vehicle on the ground."""
        self.height, self.was_left = height, False

    def update(self, height: float) -> None:
        """Take the height of a vehicle that is possibly on the ground."""
        if self.height is not None:
            self.was_left = self.was_left or abs(height - self.height) > self._threshold
