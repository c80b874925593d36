# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The update mode of an odometry: the states that the odometry may change.

The commands and the ground permit a mode. A saturated command permits at most *velocity only*, and
a long *velocity only* becomes *hold*.

*hold*: position and velocity are estimated without a model of the forces. *velocity only*:
position and velocity are estimated with the model; the parameters are considered, not changed.
*learn*: all states are estimated. *reject*: position and velocity start again from the odometry,
if the velocity is rejected by the gate of :mod:`.translation_update`.
"""

from __future__ import annotations

import enum

from quad_mpc_ros.configuration.compilation import compiled


class UpdateMode(enum.IntEnum):
    """The states that an odometry may change."""

    HOLD = 0
    VELOCITY_ONLY = 1
    LEARN = 2
    REJECT = 3


MODE_TEXTS = tuple(mode.name.lower().replace("_", " ") for mode in UpdateMode)
"""Names of the modes in mpc/stats."""


LONGEST_GAP_NS = 500_000_000
"""Longest time without odometry or without estimation for which the model is trusted [ns]."""


@compiled
def update_mode(permitted: int, saturated: bool, paused_for: float) -> UpdateMode:
    """Return the update mode; ``paused_for`` [s] is how long the mode has been velocity only."""
    pauses = permitted == UpdateMode.VELOCITY_ONLY or saturated
    too_long = pauses and paused_for > 1e-9 * LONGEST_GAP_NS
    if permitted == UpdateMode.HOLD or too_long:
        return UpdateMode.HOLD
    return UpdateMode.VELOCITY_ONLY if pauses else UpdateMode.LEARN
