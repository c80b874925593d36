# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of all bridges."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass

from quad_mpc_ros.configuration import Configuration, ConfigurationError, parameter
from quad_mpc_ros.control.model.vehicle import LiftParameters

_advanced = functools.partial(parameter, advanced=True)


@dataclass(frozen=True, kw_only=True)
class ThrustParameters(Configuration):
    """Thrust over the stack's throttle u in [0, 1], if it differs from the MPC's model."""

    owner = "bridge.thrust_map"

    kind: str = parameter(
        "model",
        doc="Thrust at the stack's throttle u: model uses thrust_curve of the MPC, linear is "
        "full_thrust u, quadratic is motor_curve for each motor, table interpolates.",
        choices=("model", "linear", "quadratic", "table"),
    )
    full_thrust: float = parameter(
        20.0, doc="linear: thrust of all motors together at u = 1.", unit="N", above=0.0
    )
    motor_curve: tuple[float, ...] = parameter(
        (1.87953563, 2.79829004, -0.00514948),
        doc="quadratic: thrust of one motor a u^2 + b u + c.",
        unit="N",
        length=3,
    )
    table_throttle: tuple[float, ...] = parameter(
        (0.0, 1.0), doc="table: increasing throttles u.", minimum=0.0, maximum=1.0
    )
    table_thrust: tuple[float, ...] = parameter(
        (0.0, 20.0), doc="table: thrust of all motors together at each throttle.", unit="N"
    )
    battery_voltage: float = parameter(
        0.0,
        doc="Battery voltage at which the map was measured; thrust scales with the ratio of "
        "measured voltage to this voltage. 0 ignores the voltage.",
        unit="V",
        minimum=0.0,
    )
    battery_exponent: float = parameter(
        2.0,
        doc="Exponent of the voltage ratio in the thrust.",
        minimum=0.0,
        maximum=4.0,
    )

    def check(self) -> None:
        """Reject maps without an inverse."""
        a, b, _ = self.motor_curve
        if a < 0.0 or b < 0.0 or a + b <= 0.0:
            raise ConfigurationError(
                f"{self.owner}.motor_curve", self.motor_curve, "a >= 0 and b >= 0, not both 0"
            )
        throttles, thrusts = self.table_throttle, self.table_thrust
        if len(throttles) < 2 or list(throttles) != sorted({*throttles}):
            raise ConfigurationError(
                f"{self.owner}.table_throttle", throttles, "two or more increasing numbers"
            )
        if len(thrusts) != len(throttles) or list(thrusts) != sorted({*thrusts}):
            raise ConfigurationError(
                f"{self.owner}.table_thrust", thrusts, f"{len(throttles)} rising numbers"
            )


@dataclass(frozen=True, kw_only=True)
class HandoverParameters(Configuration):
    """Conditions for releasing the vehicle."""

    owner = "bridge.handover"

    release_after: float = _advanced(
        0.5,
        doc="The bridge releases the vehicle after this time without a fresh command, until it is "
        "engaged again.",
        unit="s",
        minimum=0.1,
        maximum=2.0,
    )


@dataclass(frozen=True, kw_only=True)
class BridgeConfig(LiftParameters):
    """Parameters of every bridge; the vehicle is the MPC's."""

    owner = "bridge"

    frame_id: str = parameter("odom", doc="World frame of the published odometry.")
    child_frame_id: str = parameter("base_link", doc="Body frame of the published odometry.")
    mpc_command_topic: str = _advanced(
        "command",
        doc="Topic of the MPC's commands; remap command of the mpc node to the same topic.",
    )
    thrust_map: ThrustParameters = dataclasses.field(default_factory=ThrustParameters)
    handover: HandoverParameters = dataclasses.field(default_factory=HandoverParameters)


@dataclass(frozen=True, kw_only=True)
class EstimatorConfig(BridgeConfig):
    """Parameters of a bridge that uses the odometry of an estimator outside the stack."""

    odometry_topic: str = parameter(
        "stack_odom",
        doc="Topic of the estimator's nav_msgs/Odometry, in ENU; for a twist in the world frame, "
        "set odometry.twist_frame of the mpc.",
    )
