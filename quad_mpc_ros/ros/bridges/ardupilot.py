"""ArduPilot Copter's interpretation of the thrust in a setpoint, over MAVLink or MAVROS.

ArduPilot interprets the thrust as a climb rate unless bit 3 of GUID_OPTIONS is set. It divides
the thrust by the cosine of the tilt unless ATC_ANGLE_BOOST is 0 (AC_AttitudeControl_Multi.cpp).
"""

from __future__ import annotations

from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.samples import OdometrySample

_GUID_OPTION_THRUST = 8  # bit 3 of GUID_OPTIONS
_MIN_BOOST_COSINE = 0.1  # ArduPilot limits its angle boost there
_ACTUATION_DELAY = 0.01  # s: from a setpoint to the motors
_MAX_PREDICTION = 0.1  # s


def thrust_fault(guid_options: int) -> str:
    """Return an error if ArduPilot would interpret thrust as a climb rate, or an empty text."""
    if guid_options & _GUID_OPTION_THRUST:
        return ""
    return (
        f"GUID_OPTIONS is {guid_options}, and thrust would mean a climb rate: set it to "
        f"{guid_options | _GUID_OPTION_THRUST} (bit 3)"
    )


def without_boost(thrust: float, *, up: float) -> float:
    """Return the thrust to send so that the angle boost cancels out; ``up`` is cos(tilt)."""
    return thrust * min(max(up, _MIN_BOOST_COSINE), 1.0)


def cosine_of_tilt(newest: OdometrySample | None, *, now_ns: int) -> float:
    """Return the cosine of the tilt, predicted for the time at which a setpoint sent now acts."""
    if newest is None:
        return 1.0
    behind = min(max(1e-9 * (now_ns - newest.stamp_ns), 0.0), _MAX_PREDICTION)
    R_WB = so3.rotation_from_quaternion_xyzw(newest.q_WB_xyzw)
    return float((R_WB @ so3.exp((behind + _ACTUATION_DELAY) * newest.w_WB_B))[2, 2])
