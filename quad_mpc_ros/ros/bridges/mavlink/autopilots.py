# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Differences between PX4 and ArduPilot Copter: modes, state messages, parameters, throttle.

Mode numbers: ``px4_custom_mode.h`` of PX4, ``ArduCopter/mode.h`` of ArduPilot.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.ros.bridges.mavlink import codec
from quad_mpc_ros.ros.bridges.mavlink.config import MavlinkConfig

ARDUPILOT_MODES = {
    "ALT_HOLD": 2,
    "GUIDED": 4,
    "LOITER": 5,
    "RTL": 6,
    "LAND": 9,
    "BRAKE": 17,
    "GUIDED_NOGPS": 20,
}
_PX4_MODES = {1: "MANUAL", 2: "ALTCTL", 3: "POSCTL", 4: "AUTO", 5: "ACRO", 6: "OFFBOARD"}
_PX4_MODES |= {7: "STABILIZED", 10: "TERMINATION"}
_PX4_AUTO_MODES = {1: "READY", 2: "TAKEOFF", 3: "LOITER", 4: "MISSION", 5: "RTL", 6: "LAND"}
_MAX_SETPOINT_HOLD = 1.0  # s: warn if the autopilot holds the last setpoint longer
_GUID_OPTION_THRUST = 8  # bit 3 of GUID_OPTIONS: without it, thrust means a climb rate
_MIN_BOOST_COSINE = 0.1  # ArduPilot limits its angle boost there
_ACTUATION_DELAY = 0.01  # s: from a setpoint to the motors
_MAX_PREDICTION = 0.1  # s

Mode = tuple[float, float, float]
SetpointEcho = tuple[float, ...]
"""The part of a setpoint that ``ATTITUDE_TARGET`` reports unchanged."""


class Autopilot(ABC):
    """Properties of an autopilot."""

    name: ClassVar[str]
    streams: ClassVar[bool]
    """Whether setpoints must be sent before the switch to the setpoint mode."""
    warm_up: ClassVar[float]
    by_bytes: ClassVar[bool]
    """Whether integer parameters are encoded as the bytes of a float."""
    state: ClassVar[tuple[int, ...]]
    """The messages with the autopilot's state."""
    settings: ClassVar[tuple[str, ...]]
    """The names of the required autopilot parameters."""
    hold_setting: ClassVar[str]
    """The parameter [s] for how long the last setpoint is held if setpoints stop."""
    landed_mode: ClassVar[Mode | None] = None
    """The mode that detects a landing, if the mode for setpoints does not."""

    setpoint_mode: Mode
    """The parameters of DO_SET_MODE for the setpoint mode."""
    release_mode: tuple[str, Mode]
    """Name and DO_SET_MODE parameters of the mode after a release."""

    @abstractmethod
    def takes_setpoints(self, custom_mode: int) -> bool:
        """Return whether the mode executes setpoints."""

    @abstractmethod
    def mode_name(self, custom_mode: int) -> str:
        """Return the name of a mode."""

    def needs_ground_station(self, settings: Mapping[str, float]) -> bool:
        """Return whether the autopilot sends texts only to a ground station."""
        return False

    def fault(self, settings: Mapping[str, float]) -> str:
        """Return the reason why these parameters prevent a flight, or an empty string."""
        return ""

    def hold_warning(self, settings: Mapping[str, float]) -> str | None:
        """Return a warning if the last setpoint is held for too long, or None."""
        held = settings.get(self.hold_setting, 0.0)
        if held <= _MAX_SETPOINT_HOLD:
            return None
        return (
            f"{self.hold_setting} is {held:g} s: the last body rates continue for this time if "
            "the MPC stops; set 0.5 s"
        )

    def throttle(self, level: float, settings: Mapping[str, float], *, up: float) -> float:
        """Return the throttle for a motor level in [0, 1]; ``up`` is cos(tilt)."""
        return level

    @abstractmethod
    def echo(self, message: Any) -> SetpointEcho:
        """Return the echo in an ``ATTITUDE_TARGET`` or ``SET_ATTITUDE_TARGET``."""


class Px4(Autopilot):
    """PX4: executes setpoints in offboard mode, as long as they are sent."""

    name = "PX4"
    streams, warm_up = True, 1.1  # for more than a second
    by_bytes = True
    state = (codec.ODOMETRY,)
    settings = "COM_OF_LOSS_T", "NAV_DLL_ACT"
    hold_setting = "COM_OF_LOSS_T"

    _OFFBOARD, _AUTO, _LOITER = 6, 4, 3

    def __init__(self, config: MavlinkConfig) -> None:
        self.setpoint_mode = 1.0, float(self._OFFBOARD), 0.0
        self.release_mode = "AUTO.LOITER", (1.0, float(self._AUTO), float(self._LOITER))

    def takes_setpoints(self, custom_mode: int) -> bool:
        """Return whether the mode is offboard."""
        return custom_mode >> 16 & 0xFF == self._OFFBOARD

    def mode_name(self, custom_mode: int) -> str:
        """Return main and sub mode, like AUTO.LOITER."""
        main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24
        name = _PX4_MODES.get(main, f"mode {main}")
        return f"{name}.{_PX4_AUTO_MODES.get(sub, sub)}" if main == self._AUTO else name

    def needs_ground_station(self, settings: Mapping[str, float]) -> bool:
        """Return False if PX4 reacts to its loss: a bridge must not act as ground station."""
        return settings.get("NAV_DLL_ACT") == 0.0

    def echo(self, message: Any) -> SetpointEcho:
        """Return the body rates; the reported thrust belongs to another setpoint."""
        return message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate


class ArduPilot(Autopilot):
    """ArduPilot Copter: executes setpoints in guided modes and holds the last one briefly.

    ArduPilot's throttle is a share of thrust. ArduPilot divides this throttle by cos(tilt) unless
    ATC_ANGLE_BOOST is 0 (AC_AttitudeControl_Multi.cpp). MOT_THST_EXPO, MOT_SPIN_MIN and
    MOT_SPIN_MAX define the motor level (AP_Motors_Thrust_Linearization.cpp).
    """

    name = "ArduPilot"
    streams, warm_up = False, 0.0
    by_bytes = False
    state = codec.ATTITUDE_QUATERNION, codec.LOCAL_POSITION_NED
    # Its detector needs a commanded descent (Copter::update_throttle_mix).
    landed_mode = 1.0, float(ARDUPILOT_MODES["LAND"]), 0.0
    hold_setting = "GUID_TIMEOUT"

    _NEEDED = "GUID_OPTIONS", "ATC_ANGLE_BOOST", "MOT_THST_EXPO", "MOT_SPIN_MIN", "MOT_SPIN_MAX"
    settings = *_NEEDED, hold_setting

    def __init__(self, config: MavlinkConfig) -> None:
        self.setpoint_mode = 1.0, float(ARDUPILOT_MODES[config.guided_mode]), 0.0
        released = config.release_mode
        self.release_mode = released, (1.0, float(ARDUPILOT_MODES[released]), 0.0)

    def takes_setpoints(self, custom_mode: int) -> bool:
        """Return whether the mode is a guided mode."""
        return custom_mode in (ARDUPILOT_MODES["GUIDED"], ARDUPILOT_MODES["GUIDED_NOGPS"])

    def mode_name(self, custom_mode: int) -> str:
        """Return the name of a known mode, or the number."""
        names = {number: name for name, number in ARDUPILOT_MODES.items()}
        return names.get(custom_mode, f"mode {custom_mode}")

    def fault(self, settings: Mapping[str, float]) -> str:
        """Return an error if thrust would be a climb rate, or a parameter is missing."""
        if missing := [name for name in self._NEEDED if name not in settings]:
            return f"ArduPilot does not report its parameter {missing[0]}"
        options = int(settings["GUID_OPTIONS"])
        if options & _GUID_OPTION_THRUST:
            return ""
        return (
            f"GUID_OPTIONS is {options}, which makes thrust a climb rate: set it to "
            f"{options | _GUID_OPTION_THRUST} (bit 3)"
        )

    def throttle(self, level: float, settings: Mapping[str, float], *, up: float) -> float:
        """Return the share of thrust for a motor level, with the angle boost removed."""
        least, most = settings["MOT_SPIN_MIN"], settings["MOT_SPIN_MAX"]
        expo = min(max(settings["MOT_THST_EXPO"], -1.0), 1.0)
        rise = min(max((level - least) / max(most - least, 1e-3), 0.0), 1.0)
        share = (1.0 - expo) * rise + expo * rise * rise
        if settings["ATC_ANGLE_BOOST"] != 0.0:
            share *= min(max(up, _MIN_BOOST_COSINE), 1.0)
        return min(max(share, 0.0), 1.0)

    def echo(self, message: Any) -> SetpointEcho:
        """Return the thrust; ArduPilot shapes the rates."""
        return (message.thrust,)


AUTOPILOTS: dict[int, type[Px4] | type[ArduPilot]] = {3: ArduPilot, 12: Px4}
"""By MAV_AUTOPILOT."""


def cosine_of_tilt(newest: OdometrySample | None, *, now_ns: int) -> float:
    """Return the cosine of the tilt, predicted for the time at which a setpoint sent now acts."""
    if newest is None:
        return 1.0
    behind = min(max(1e-9 * (now_ns - newest.stamp_ns), 0.0), _MAX_PREDICTION)
    R_WB = so3.rotation_from_quaternion_xyzw(newest.q_WB_xyzw)
    return float((R_WB @ so3.exp((behind + _ACTUATION_DELAY) * newest.w_WB_B))[2, 2])
