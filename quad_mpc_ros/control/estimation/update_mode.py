"""The update mode of an odometry, by the conditions since the previous one: first matching row.

| commands act | flies | little thrust, or saturated | for long | mode |
|---|---|---|---|---|
| no | | | | hold |
| | no | | | hold |
| yes | yes | yes | yes | hold |
| yes | yes | yes | no | velocity only |
| yes | yes | no | | learn |

*hold*: position and velocity are estimated without a model of the forces. *velocity only*: they
are estimated by the model; the parameters are considered, not changed. *learn*: all states are
estimated. *reject*: position and velocity start again from the odometry, whose velocity did not
pass the gate of :mod:`.translation_update`.
"""

from __future__ import annotations

import enum
from typing import NamedTuple

from quad_mpc_ros.configuration.compilation import compiled


class UpdateMode(enum.IntEnum):
    """The states that an odometry may change."""

    HOLD = 0
    VELOCITY_ONLY = 1
    LEARN = 2
    REJECT = 3


MODE_TEXTS = tuple(mode.name.lower().replace("_", " ") for mode in UpdateMode)
"""Names of the modes in mpc/stats."""


class Conditions(NamedTuple):
    """Conditions since the previous odometry.

    ``acts``: the controller's commands act, long enough and without a gap. ``flies``: the vehicle
    certainly flies, long enough. ``may_touch``: the ground might carry part of the weight.
    """

    acts: bool
    is_flying: bool
    may_touch: bool


LONGEST_GAP_NS = 500_000_000
"""Longest time without odometry or without learning for which the model is trusted [ns]."""


@compiled
def update_mode(conditions: Conditions, saturated: bool, paused_for: float) -> UpdateMode:
    """Return the update mode; ``paused_for`` [s] is how long the mode has been velocity only."""
    pauses = conditions.may_touch or saturated
    too_long = pauses and paused_for > 1e-9 * LONGEST_GAP_NS
    if not (conditions.acts and conditions.is_flying) or too_long:
        return UpdateMode.HOLD
    return UpdateMode.VELOCITY_ONLY if pauses else UpdateMode.LEARN
