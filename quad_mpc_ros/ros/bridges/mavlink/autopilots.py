"""Differences between PX4 and ArduPilot: modes, state messages and parameters.

Mode numbers: ``px4_custom_mode.h`` of PX4, ``ArduCopter/mode.h`` of ArduPilot.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from quad_mpc_ros.ros.bridges.ardupilot import thrust_fault, without_boost
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
_MAX_HOVER_RATIO = 1.3  # between two hover throttles of one vehicle

Mode = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class SetpointEcho:
    """The part of a setpoint that ``ATTITUDE_TARGET`` reports unchanged."""

    value: tuple[float, ...]

    def matches(self, other: SetpointEcho) -> bool:
        """Return whether both are equal in single precision."""
        return all(
            math.isclose(a, b, rel_tol=1e-5, abs_tol=1e-5)
            for a, b in zip(self.value, other.value, strict=True)
        )


class Autopilot(ABC):
    """Properties of an autopilot."""

    name: ClassVar[str]
    streams: ClassVar[bool]
    """Whether setpoints must be sent before the switch to them."""
    warm_up: ClassVar[float]
    by_bytes: ClassVar[bool]
    """Whether integer parameters are encoded as the bytes of a float."""
    state: ClassVar[tuple[int, ...]]
    """The messages with its state."""
    landed_mode: ClassVar[Mode | None] = None
    """The mode that detects a landing, if the mode for setpoints does not."""

    def __init__(self, config: MavlinkConfig) -> None:
        self._config = config

    @property
    @abstractmethod
    def setpoint_mode(self) -> Mode:
        """The parameters of DO_SET_MODE for the setpoint mode."""

    @property
    @abstractmethod
    def release_mode(self) -> tuple[str, Mode]:
        """Name and DO_SET_MODE parameters of the mode after a release."""

    @abstractmethod
    def takes_setpoints(self, custom_mode: int) -> bool:
        """Return whether the mode executes setpoints."""

    @abstractmethod
    def mode_name(self, custom_mode: int) -> str:
        """Return the name of a mode."""

    @property
    @abstractmethod
    def settings(self) -> tuple[str, ...]:
        """The names of the required autopilot parameters."""

    def needs_ground_station(self, settings: Mapping[str, float]) -> bool:
        """Return whether it sends texts only to a ground station."""
        return False

    @abstractmethod
    def fault(self, settings: Mapping[str, float]) -> str:
        """Return the reason why it must not be flown with these parameters, or an empty string."""

    @abstractmethod
    def advice(self, settings: Mapping[str, float], *, hover: float) -> list[str]:
        """Return warnings about its parameters; ``hover`` is the configured hover throttle."""

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

    _OFFBOARD, _AUTO, _LOITER = 6, 4, 3

    @property
    def setpoint_mode(self) -> Mode:
        """Offboard."""
        return 1.0, float(self._OFFBOARD), 0.0

    @property
    def release_mode(self) -> tuple[str, Mode]:
        """Hold."""
        return "AUTO.LOITER", (1.0, float(self._AUTO), float(self._LOITER))

    def takes_setpoints(self, custom_mode: int) -> bool:
        """Return whether the mode is offboard."""
        return custom_mode >> 16 & 0xFF == self._OFFBOARD

    def mode_name(self, custom_mode: int) -> str:
        """Return main and sub mode, like AUTO.LOITER."""
        main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24
        name = _PX4_MODES.get(main, f"mode {main}")
        return f"{name}.{_PX4_AUTO_MODES.get(sub, sub)}" if main == self._AUTO else name

    @property
    def settings(self) -> tuple[str, ...]:
        """Hover throttle, setpoint timeout, and reaction to the loss of a ground station."""
        return "MPC_THR_HOVER", "COM_OF_LOSS_T", "NAV_DLL_ACT"

    def needs_ground_station(self, settings: Mapping[str, float]) -> bool:
        """Return False if PX4 reacts to its loss: a bridge must not replace a ground station."""
        return settings.get("NAV_DLL_ACT") == 0.0

    def fault(self, settings: Mapping[str, float]) -> str:
        """Return an empty string: offboard rates and throttle need no parameters."""
        return ""

    def advice(self, settings: Mapping[str, float], *, hover: float) -> list[str]:
        """Return warnings about hover throttle, setpoint timeout and ground station."""
        notes = []
        value = settings.get("MPC_THR_HOVER", hover)
        if not 1.0 / _MAX_HOVER_RATIO < value / max(hover, 1e-3) < _MAX_HOVER_RATIO:
            notes.append(
                f"MPC_THR_HOVER is {value:.2f}, the vehicle file gives {hover:.2f}: check "
                "mass and thrust curve"
            )
        held = settings.get("COM_OF_LOSS_T", 0.0)
        if held > _MAX_SETPOINT_HOLD:
            notes.append(_hold_warning("COM_OF_LOSS_T", held))
        if settings.get("NAV_DLL_ACT", 0.0) != 0.0:
            notes.append(
                f"NAV_DLL_ACT is {settings['NAV_DLL_ACT']:g}, so this bridge does not announce "
                "itself as a ground station and receives no texts of PX4: if PX4 refuses to arm, "
                "read the reason in the ground station"
            )
        return notes

    def echo(self, message: Any) -> SetpointEcho:
        """Return the body rates; the reported thrust belongs to another setpoint."""
        p, q, r = message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate
        return SetpointEcho(value=(p, q, r))


class ArduPilot(Autopilot):
    """ArduPilot Copter: executes setpoints in a guided mode and holds the last one for a while.

    Its throttle is a share of thrust. It is divided by cos(tilt) unless ATC_ANGLE_BOOST is 0
    (AC_AttitudeControl_Multi.cpp). MOT_THST_EXPO, MOT_SPIN_MIN and MOT_SPIN_MAX define the motor
    level (AP_Motors_Thrust_Linearization.cpp).
    """

    name = "ArduPilot"
    streams, warm_up = False, 0.0
    by_bytes = False
    state = codec.ATTITUDE_QUATERNION, codec.LOCAL_POSITION_NED
    # Its detector needs a commanded descent (Copter::update_throttle_mix).
    landed_mode = 1.0, float(ARDUPILOT_MODES["LAND"]), 0.0

    _RATES = ("ATC_RATE_R_MAX", "ATC_RATE_P_MAX", "ATC_RATE_Y_MAX")

    @property
    def setpoint_mode(self) -> Mode:
        """The configured guided mode."""
        return 1.0, float(ARDUPILOT_MODES[self._config.guided_mode]), 0.0

    @property
    def release_mode(self) -> tuple[str, Mode]:
        """The configured release mode."""
        name = self._config.release_mode
        return name, (1.0, float(ARDUPILOT_MODES[name]), 0.0)

    def takes_setpoints(self, custom_mode: int) -> bool:
        """Return whether the mode is a guided mode."""
        return custom_mode in (ARDUPILOT_MODES["GUIDED"], ARDUPILOT_MODES["GUIDED_NOGPS"])

    def mode_name(self, custom_mode: int) -> str:
        """Return the name of a known mode, or the number."""
        names = {number: name for name, number in ARDUPILOT_MODES.items()}
        return names.get(custom_mode, f"mode {custom_mode}")

    @property
    def settings(self) -> tuple[str, ...]:
        """Interpretation of the throttle, setpoint timeout, voltage and bounds of the rates."""
        return (
            *("GUID_OPTIONS", "ATC_ANGLE_BOOST", "MOT_THST_EXPO", "MOT_SPIN_MIN", "MOT_SPIN_MAX"),
            *("GUID_TIMEOUT", "MOT_BAT_VOLT_MAX", *self._RATES),
        )

    def fault(self, settings: Mapping[str, float]) -> str:
        """Return an error if thrust would be a climb rate, or a parameter is missing."""
        for name in self.settings[:5]:
            if name not in settings:
                return f"ArduPilot does not report its parameter {name}"
        return thrust_fault(int(settings["GUID_OPTIONS"]))

    def advice(self, settings: Mapping[str, float], *, hover: float) -> list[str]:
        """Return warnings about setpoint timeout, bounds of the rates and voltage."""
        notes = []
        held = settings.get("GUID_TIMEOUT", 0.0)
        if held > _MAX_SETPOINT_HOLD:
            notes.append(_hold_warning("GUID_TIMEOUT", held))
        bounds = {name: settings.get(name, 0.0) for name in self._RATES}
        if any(bounds.values()):
            rates = ", ".join(f"{math.radians(each):.2f}" for each in bounds.values())
            notes.append(
                f"ATC_RATE_R_MAX, _P_MAX and _Y_MAX bound the body rates to {rates} rad/s (0: "
                "not): keep mpc.omega_max within"
            )
        if settings.get("MOT_BAT_VOLT_MAX", 0.0) > 0.0 and (
            self._config.thrust_map.battery_voltage > 0.0
        ):
            notes.append(
                "MOT_BAT_VOLT_MAX compensates the voltage already: set "
                "thrust_map.battery_voltage to 0"
            )
        return notes

    def throttle(self, level: float, settings: Mapping[str, float], *, up: float) -> float:
        """Return the share of thrust for a motor level, with the angle boost removed."""
        least, most = settings["MOT_SPIN_MIN"], settings["MOT_SPIN_MAX"]
        expo = min(max(settings["MOT_THST_EXPO"], -1.0), 1.0)
        rise = min(max((level - least) / max(most - least, 1e-3), 0.0), 1.0)
        share = (1.0 - expo) * rise + expo * rise * rise
        if settings["ATC_ANGLE_BOOST"] != 0.0:
            share = without_boost(share, up=up)
        return min(max(share, 0.0), 1.0)

    def echo(self, message: Any) -> SetpointEcho:
        """Return the thrust; ArduPilot shapes the rates."""
        return SetpointEcho(value=(message.thrust,))


AUTOPILOTS: dict[int, type[Autopilot]] = {3: ArduPilot, 12: Px4}
"""By MAV_AUTOPILOT."""


def _hold_warning(name: str, held: float) -> str:
    return (
        f"{name} is {held:g} s: the last body rates continue for so long if the MPC stops; set "
        "0.5 s"
    )
