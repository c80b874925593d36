"""Attitudes along a path whose thrust may point anywhere, upside down included.

No continuous choice of attitude as a function of the thrust's direction alone exists on the whole
sphere, so a path that is flown upside down needs one that remembers where it came from. Here it is
the rotation-minimising one: the body turns with its thrust axis and never about it, w_z = 0. In a
vertical loop that is pitching on through 180 degrees, and of all attitudes it asks for the least
body rates. See Wang, Juettler, Zheng and Liu, "Computation of rotation minimizing frames" (2008).

It is made of charts of the Hopf fibration (``flatness.py``), one at each knot in time,
centred on the thrust's direction there and joined so that the attitude is continuous. Between two
knots the thrust is never far from the centre of its chart, so no chart is used near where it is
singular, and the attitude at any time comes from the path at that time and the chart of its knot.

The price is memory: the heading after a spatial manoeuvre depends on the way taken. A path whose
thrust stays above the horizon therefore keeps the single chart, in which yaw is yaw.
"""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.lie import Array, so3

_ABOUT = -0.99  # cosine of a turn in 2 ms that is none


class ThrustFrames:
    """The charts of a path, by time."""

    def __init__(self, knots: Array, z: Array) -> None:
        """Join charts at ``knots`` (n,) [s], where the thrust points along ``z`` (n, 3).

        Raises ``ValueError`` where the thrust turns about between two knots.
        """
        about = np.flatnonzero(np.sum(z[:-1] * z[1:], axis=-1) < _ABOUT)
        if len(about):
            raise ValueError(f"at {knots[about[0]]:.3f} s the thrust turns about at once")
        self._knots = knots
        self._charts = np.empty((len(knots), 3, 3))
        chart = rotations_between(np.array([[0.0, 0.0, 1.0]]), z[:1])[0]
        self._charts[0] = chart
        for place, step in enumerate(rotations_between(z[:-1], z[1:]), start=1):
            chart = step @ chart
            self._charts[place] = chart

    def at(self, seconds: Array) -> Array:
        """Return the charts (n, 3, 3) for times (n,) [s]."""
        last = len(self._knots) - 1
        places = np.clip(np.searchsorted(self._knots, seconds, side="right") - 1, 0, last)
        return np.asarray(self._charts[places])


def rotations_between(start: Array, end: Array) -> Array:
    """Return the shortest rotations (n, 3, 3) that take unit vectors to others, (n, 3) each.

    There is none between opposite ones.
    """
    cosine = np.sum(start * end, axis=-1)
    skew = so3.hat(np.cross(start, end))
    # Rodrigues' formula without an angle: (1 - cos) / sin^2 = 1 / (1 + cos).
    return np.asarray(np.eye(3) + skew + skew @ skew / (1.0 + cosine)[:, None, None])
