"""Who judges whether the vehicle is on the ground, and the thresholds that they share.

Four judges know different things and must not err in the same direction:

- ``control/estimation/contact.py``: does it certainly stand, or certainly fly? By odometry, the
  thrust of commands, and the reference. In doubt neither: motors turn, and nothing is learned.
- ``references/touchdown.py``: is the landing over? By odometry, and how far the reference is below
  the vehicle. In doubt no: the reference sinks on.
- ``references/live.py``: where does the reference wait while commands do not act? By what the
  flight stack reports, else by height. In doubt on the ground where the vehicle was seen first.
- ``ros/bridges/handover.py``: may the MPC take over, and what is published as ``landed``? By
  whether it is armed, and height. In doubt nothing is published, and a command may have any thrust
  of one on the ground or in the air.

The signal to stay down is a reference :data:`STAY_DOWN_DEPTH` below the ground
(:func:`stay_down`); :func:`asks_to_sink` reads it.
"""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.control.lie import Array

NO_LIFT = 0.4
"""Thrust as a share of the weight: with no more no vehicle lifts off, or stays in the air."""

LEFT_GROUND = 0.15
"""Distance [m] from where it stood, beyond which a vehicle under thrust flies."""
LEFT_GROUND_UNPOWERED = 0.3
"""The same where neither thrust nor arming is known, so that a drifting estimate must not do."""

STAY_DOWN_DEPTH = 0.5
"""Depth [m] of a reference that asks for idle motors; at 0.3 both formulations give no throttle.

A vehicle that does not stand there after all sinks by as much and no further.
"""
SINKING = 0.1
"""Distance [m] of a reference below the vehicle that asks it to sink."""
SINKING_IN_VAIN = 0.15
"""The same for a landing: a vehicle in the air would follow within it."""
CLIMBING = 0.1
"""Distance [m] of a reference above the vehicle that asks it to climb."""
TAKING_OFF = 0.3
"""The same for one on the ground that nobody should hand over: more than odometry drifts."""


def stay_down(p_WB: Array) -> Array:
    """Return the reference (3,) [m] that keeps a vehicle on the ground at ``p_WB`` (3,)."""
    return np.asarray(p_WB - [0.0, 0.0, STAY_DOWN_DEPTH])


def asks_to_sink(reference_height: float, height: float) -> bool:
    """Whether a reference wants the vehicle lower [m], as one does that asks it to stay down."""
    return reference_height < height - SINKING


class StandingHeight:
    """The height [m] at which a vehicle stood last, and whether it has left it since."""

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
