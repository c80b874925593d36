"""What an odometry may change, by what happened since the one before: the first row that holds.

| commands act | flies | little thrust, or saturated | for long | mode |
|---|---|---|---|---|
| no | | | | hold |
| | no | | | hold |
| yes | yes | yes | yes | hold |
| yes | yes | yes | no | velocity only |
| yes | yes | no | | learn |

*hold*: position and velocity are followed by themselves, by no model of what moves the vehicle.
*velocity only*: by the model; what is learned of the vehicle is considered, not changed.
*learn*: all. *reject*: position and velocity start again from the odometry, whose velocity did not
pass the gate of :mod:`.translation_update`.
"""

from __future__ import annotations

import enum
from typing import NamedTuple

from quad_mpc_ros.configuration.compilation import compiled


class UpdateMode(enum.IntEnum):
    """What an odometry may change."""

    HOLD = 0
    VELOCITY_ONLY = 1
    LEARN = 2
    REJECT = 3


MODE_TEXTS = tuple(mode.name.lower().replace("_", " ") for mode in UpdateMode)
"""Names of the modes in mpc/stats."""


class Conditions(NamedTuple):
    """What happened since the odometry before.

    Commands of the controller act, for long enough and without a gap; the vehicle is certain to
    fly, and has for long enough; the ground might carry some of it.
    """

    acts: bool
    flies: bool
    may_touch: bool


LONGEST_GAP_NS = 500_000_000
"""For how long the model alone is trusted [ns], without odometry or with nothing learned of it."""


@compiled
def update_mode(conditions: Conditions, saturated: bool, paused_for: float) -> UpdateMode:
    """Return the update mode; ``paused_for`` [s] is how long it has been velocity only."""
    pauses = conditions.may_touch or saturated
    too_long = pauses and paused_for > 1e-9 * LONGEST_GAP_NS
    if not (conditions.acts and conditions.flies) or too_long:
        return UpdateMode.HOLD
    return UpdateMode.VELOCITY_ONLY if pauses else UpdateMode.LEARN
