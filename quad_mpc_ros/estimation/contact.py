"""Does the vehicle stand on the ground? Judged by odometry and commands: at rest without lift.

Two ask: the supervisor, which lets the motors idle where it would hover, and the disturbance EKF,
which learns nothing on the ground, for the ground carries what the thrust does not.

Two others are apart on purpose. ``trajectories/touchdown.py`` asks whether a landing has come to
its end, and knows no commands but how far below the vehicle the reference is. The ground of
``simulation/`` is part of the plant: neither can hide a mistake of the other.
"""

from __future__ import annotations

from quad_mpc_ros.compilation import compiled

REST_SPEED = 0.1  # m/s
# Lift as a share of the weight: too little cannot keep the vehicle at rest in the air, even if the
# true thrust is 1.5 times the modelled; enough may have lifted it.
_TOO_LITTLE, _ENOUGH = 0.6, 0.95
# How long too little lift at rest must last. In the air the vehicle would be faster than rest
# within 30 ms, or 100 ms with 1.5 times the thrust. The supervisor takes the throttle away and
# waits a little longer than the EKF, which would learn a lack of thrust.
_STANDING_DWELL_NS = 300_000_000
_LANDED_DWELL = 0.25  # s


class GroundContact:
    """``standing``: flying, until some time has shown that it cannot be."""

    def __init__(self) -> None:
        self.standing = False
        self._too_little, self._enough = _Lasting(), _Lasting()

    def update(self, *, speed: float, lift: float, now_ns: int) -> bool:
        """Return whether it stands, from its speed [m/s] and its lift as a share of its weight."""
        resting = speed < REST_SPEED
        grounded = self._too_little.update(resting and lift <= _TOO_LITTLE, now_ns=now_ns)
        lifted = self._enough.update(lift > _ENOUGH, now_ns=now_ns)
        if grounded:
            self.standing = True
        elif lifted or not resting:
            self.standing = False
        return self.standing


class _Lasting:
    """Whether something has been true for longer than the dwell time."""

    def __init__(self) -> None:
        self._since_ns: int | None = None

    def update(self, true: bool, *, now_ns: int) -> bool:
        if not true:
            self._since_ns = None
            return False
        if self._since_ns is None:
            self._since_ns = now_ns
        return now_ns - self._since_ns > _STANDING_DWELL_NS


@compiled
def airborne(
    before: float, square_speed: float, thrust: float, gravity: float, duration: float
) -> float:
    """Return 1 in flight, 0 on the ground, between them while it seems to have landed.

    ``before`` is what was returned ``duration`` [s] ago, 0 to begin with; the square of the speed
    is in m^2/s^2, the upward thrust over the mass and gravity in m/s^2. Unlike
    :class:`GroundContact`, it takes a vehicle that has never been seen to fly for one that stands.
    """
    resting = square_speed < REST_SPEED**2
    if not resting or thrust > _ENOUGH * gravity:
        return 1.0
    if thrust < _TOO_LITTLE * gravity:
        return max(before - duration / _LANDED_DWELL, 0.0)
    return 1.0 if before > 0.0 else before
