"""What PX4 and ArduPilot do not share: modes, reported state, and settings.

Numbers of modes after PX4 (``px4_custom_mode.h``) and ArduPilot (``ArduCopter/mode.h``).
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
_MAX_SETPOINT_HOLD = 1.0  # s: of the last rates and thrust, before a warning
_MAX_HOVER_RATIO = 1.3  # between two throttles at hover, which then are not of the same vehicle

Mode = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class SetpointEcho:
    """What an ``ATTITUDE_TARGET`` gives back of a setpoint, which is as it was sent."""

    value: tuple[float, ...]

    def matches(self, other: SetpointEcho) -> bool:
        """Whether both are of one setpoint, to what single precision keeps."""
        return all(
            math.isclose(a, b, rel_tol=1e-5, abs_tol=1e-5)
            for a, b in zip(self.value, other.value, strict=True)
        )


class Autopilot(ABC):
    """What a bridge must know of the autopilot at the other end."""

    name: ClassVar[str]
    streams: ClassVar[bool]
    """Whether setpoints must run before the switch to them."""
    warm_up: ClassVar[float]
    by_bytes: ClassVar[bool]
    """Whether integer parameters travel as the bytes of a float."""
    state: ClassVar[tuple[int, ...]]
    """The messages of its state."""
    landed_mode: ClassVar[Mode | None] = None
    """The mode that notices a landing, where the one for setpoints does not."""

    def __init__(self, config: MavlinkConfig) -> None:
        self._config = config

    @property
    @abstractmethod
    def setpoint_mode(self) -> Mode:
        """The parameters of DO_SET_MODE for the mode that takes setpoints."""

    @property
    @abstractmethod
    def release_mode(self) -> tuple[str, Mode]:
        """Name and parameters of the mode in which it flies by itself."""

    @abstractmethod
    def takes_setpoints(self, custom_mode: int) -> bool:
        """Whether it flies setpoints in a mode."""

    @abstractmethod
    def mode_name(self, custom_mode: int) -> str:
        """Return the name of a mode."""

    @property
    @abstractmethod
    def settings(self) -> tuple[str, ...]:
        """The parameters of the vehicle that matter."""

    def needs_ground_station(self, settings: Mapping[str, float]) -> bool:
        """Whether it sends texts only where a ground station announces itself."""
        return False

    @abstractmethod
    def fault(self, settings: Mapping[str, float]) -> str:
        """Return why it must not be flown with these settings, or nothing."""

    @abstractmethod
    def advice(self, settings: Mapping[str, float], *, hover: float) -> list[str]:
        """Return what its settings give reason to say; ``hover`` is our throttle there."""

    def throttle(self, level: float, settings: Mapping[str, float], *, up: float) -> float:
        """Return the throttle that makes the motors' level in [0, 1]; ``up`` is cos(tilt)."""
        return level

    @abstractmethod
    def echo(self, message: Any) -> SetpointEcho:
        """Return what an ``ATTITUDE_TARGET`` or ``SET_ATTITUDE_TARGET`` says of a setpoint."""


class Px4(Autopilot):
    """PX4, which flies setpoints in offboard mode, while they run."""

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
        """In offboard mode."""
        return custom_mode >> 16 & 0xFF == self._OFFBOARD

    def mode_name(self, custom_mode: int) -> str:
        """Return main and sub mode, like AUTO.LOITER."""
        main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24
        name = _PX4_MODES.get(main, f"mode {main}")
        return f"{name}.{_PX4_AUTO_MODES.get(sub, sub)}" if main == self._AUTO else name

    @property
    def settings(self) -> tuple[str, ...]:
        """Hover throttle, time without setpoints, and what the loss of a ground station does."""
        return "MPC_THR_HOVER", "COM_OF_LOSS_T", "NAV_DLL_ACT"

    def needs_ground_station(self, settings: Mapping[str, float]) -> bool:
        """Unless PX4 acts on the loss of one: a bridge must not stand in for it."""
        return settings.get("NAV_DLL_ACT") == 0.0

    def fault(self, settings: Mapping[str, float]) -> str:
        """Return nothing: offboard rates and throttle are taken as they are."""
        return ""

    def advice(self, settings: Mapping[str, float], *, hover: float) -> list[str]:
        """Return what is odd about hover throttle and timeout."""
        notes = []
        value = settings.get("MPC_THR_HOVER", hover)
        if not 1.0 / _MAX_HOVER_RATIO < value / max(hover, 1e-3) < _MAX_HOVER_RATIO:
            notes.append(
                f"MPC_THR_HOVER is {value:.2f}, and the vehicle file says {hover:.2f}: one of "
                "them is of another vehicle"
            )
        held = settings.get("COM_OF_LOSS_T", 0.0)
        if held > _MAX_SETPOINT_HOLD:
            notes.append(_hold_warning("COM_OF_LOSS_T", held))
        if settings.get("NAV_DLL_ACT", 0.0) != 0.0:
            notes.append(
                f"NAV_DLL_ACT is {settings['NAV_DLL_ACT']:g}, so this bridge does not announce "
                "itself as a ground station, and PX4 does not send its texts here: see there for "
                "the reason if PX4 refuses to arm"
            )
        return notes

    def echo(self, message: Any) -> SetpointEcho:
        """Return the body rates; the thrust is that of another setpoint."""
        p, q, r = message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate
        return SetpointEcho(value=(p, q, r))


class ArduPilot(Autopilot):
    """ArduPilot Copter, which flies setpoints in a guided mode, and holds the last ones a while.

    Its throttle is a share of thrust: it takes the motors' level from it by MOT_THST_EXPO,
    MOT_SPIN_MIN and MOT_SPIN_MAX (``AP_Motors_Thrust_Linearization.cpp``), after it has divided
    it by the cosine of the vehicle's tilt, unless ATC_ANGLE_BOOST is 0
    (``AC_AttitudeControl_Multi.cpp``).
    """

    name = "ArduPilot"
    streams, warm_up = False, 0.0
    by_bytes = False
    state = codec.ATTITUDE_QUATERNION, codec.LOCAL_POSITION_NED
    # Its detector wants a descent that is asked for (Copter::update_throttle_mix).
    landed_mode = 1.0, float(ARDUPILOT_MODES["LAND"]), 0.0

    _RATES = ("ATC_RATE_R_MAX", "ATC_RATE_P_MAX", "ATC_RATE_Y_MAX")

    @property
    def setpoint_mode(self) -> Mode:
        """The guided mode of the configuration."""
        return 1.0, float(ARDUPILOT_MODES[self._config.guided_mode]), 0.0

    @property
    def release_mode(self) -> tuple[str, Mode]:
        """The mode of the configuration."""
        name = self._config.release_mode
        return name, (1.0, float(ARDUPILOT_MODES[name]), 0.0)

    def takes_setpoints(self, custom_mode: int) -> bool:
        """In either guided mode."""
        return custom_mode in (ARDUPILOT_MODES["GUIDED"], ARDUPILOT_MODES["GUIDED_NOGPS"])

    def mode_name(self, custom_mode: int) -> str:
        """Return the name, of a mode that is used here, or the number."""
        names = {number: name for name, number in ARDUPILOT_MODES.items()}
        return names.get(custom_mode, f"mode {custom_mode}")

    @property
    def settings(self) -> tuple[str, ...]:
        """What the throttle means, what is held how long, and what bounds the rates."""
        return (
            *("GUID_OPTIONS", "ATC_ANGLE_BOOST", "MOT_THST_EXPO", "MOT_SPIN_MIN", "MOT_SPIN_MAX"),
            *("GUID_TIMEOUT", "MOT_BAT_VOLT_MAX", *self._RATES),
        )

    def fault(self, settings: Mapping[str, float]) -> str:
        """Return whether thrust would mean a climb rate, or is unknown."""
        for name in self.settings[:5]:
            if name not in settings:
                return f"ArduPilot does not report its parameter {name}"
        return thrust_fault(int(settings["GUID_OPTIONS"]))

    def advice(self, settings: Mapping[str, float], *, hover: float) -> list[str]:
        """Return what is odd about timeout, rates and voltage."""
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
        """Return the share of thrust for the motors' level, with the boost taken out."""
        least, most = settings["MOT_SPIN_MIN"], settings["MOT_SPIN_MAX"]
        expo = min(max(settings["MOT_THST_EXPO"], -1.0), 1.0)
        rise = min(max((level - least) / max(most - least, 1e-3), 0.0), 1.0)
        share = (1.0 - expo) * rise + expo * rise * rise
        if settings["ATC_ANGLE_BOOST"] != 0.0:
            share = without_boost(share, up=up)
        return min(max(share, 0.0), 1.0)

    def echo(self, message: Any) -> SetpointEcho:
        """Return the thrust; the rates are shaped."""
        return SetpointEcho(value=(message.thrust,))


AUTOPILOTS: dict[int, type[Autopilot]] = {3: ArduPilot, 12: Px4}
"""By MAV_AUTOPILOT."""


def _hold_warning(name: str, held: float) -> str:
    return (
        f"{name} is {held:g} s: for so long the last body rates are flown on when the MPC stops; "
        "0.5 s is enough"
    )
