# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The vehicle: mass, drag, the throttle curve of the paper (Eq. 2, Table 1), and outline."""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Any

import numpy as np

from quad_mpc_ros.configuration import (
    ArgumentError,
    Configuration,
    ConfigurationError,
    PerAxis,
    parameter,
    per_axis,
)
from quad_mpc_ros.control.lie import Array

ARM = 0.11
"""Distance from the centre to a rotor [m]: the paper's 220 mm diagonal."""

LATENCY_UNCERTAINTY = 0.003, 0.15
"""Half the 95 % interval of the latency [s]: the smallest, and that of an unidentified vehicle."""

_ROTOR_POINTS = 24


@dataclasses.dataclass(frozen=True, kw_only=True)
class ActuatorLags:
    """Lags of the model's throttle and body rates behind their commands.

    Attributes:
        thrust: Time constant of the throttle [s].
        thrust_down: Time constant of a falling throttle [s], 0 if equal.
        rate: Time constant of the body rates, one over the gain of their loop [s].
        torque: Time constant of the torque [s].
        angular_acceleration_max: Bound of the angular acceleration [rad/s^2], 0 for none.
    """

    thrust: float
    rate: PerAxis
    thrust_down: float = 0.0
    torque: PerAxis = 0.0
    angular_acceleration_max: PerAxis = 0.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class LiftParameters(Configuration):
    """Mass and thrust of the vehicle; the defaults are the paper's quadrotor."""

    mass: float = parameter(
        0.396893, doc="Mass M with battery (14 oz in the paper).", unit="kg", above=0.0
    )
    gravity: float = parameter(9.81, doc="Gravity g.", unit="m/s^2", above=0.0)
    motor_count: int = parameter(4, doc="Number of motors.", minimum=1)
    thrust_curve: tuple[float, ...] = parameter(
        (1.87953563, 2.79829004, -0.00514948),
        doc="Thrust of one motor a s^2 + b s + c at throttle s (Eq. 2, Table 1).",
        unit="N",
        length=3,
    )

    def check(self) -> None:
        """Reject a thrust curve without an inverse, and a vehicle that cannot hover."""
        a, b, _ = self.thrust_curve
        if a < 0.0 or b < 0.0 or a + b <= 0.0:
            raise ConfigurationError(
                f"{self.owner}.thrust_curve",
                self.thrust_curve,
                "a >= 0 and b >= 0, not both 0: thrust rises with throttle",
            )
        self.check_hover("mass", self.mass, self.mass)

    def check_hover(self, name: str, value: float, mass: float) -> None:
        """Reject a mass [kg], from parameter ``name``, that the motors cannot lift."""
        lowest, highest = self.thrust(0.0), self.thrust(1.0)
        if not lowest < mass * self.gravity < highest:
            raise ConfigurationError(
                f"{self.owner}.{name}",
                value,
                f"a weight between the thrust at throttle 0 and at 1, "
                f"{lowest:.4g} N to {highest:.4g} N",
            )

    def thrust(self, throttle: float) -> float:
        """Return the total thrust [N] at a throttle (Eq. 2 times the number of motors)."""
        a, b, c = self.thrust_curve
        return self.motor_count * throttle_curve(a, b, c, throttle)

    def vehicle(self) -> Vehicle:
        """Return the vehicle of these parameters; missing parameters have the paper's defaults."""
        fields = dataclasses.fields(VehicleParameters)
        return _vehicle(**{f.name: getattr(self, f.name) for f in fields if hasattr(self, f.name)})


@dataclasses.dataclass(frozen=True, kw_only=True)
class VehicleParameters(LiftParameters):
    """Mass, thrust and drag of the vehicle; the defaults are the paper's quadrotor."""

    drag: float | tuple[float, ...] = parameter(
        0.2, doc="Linear drag mu, acceleration per velocity.", unit="1/s", minimum=0.0
    )
    rotor_drag: float | tuple[float, ...] = parameter(
        0.0,
        doc="Drag proportional to the rotor speed, acceleration per velocity at the rotor speed "
        "of hover.",
        unit="1/s",
        minimum=0.0,
    )
    translational_lift: float = parameter(
        0.0,
        doc="Translational lift k_h: acceleration along body z per square of the velocity along "
        "body x and y.",
        unit="1/m",
        minimum=0.0,
    )
    radius: float = parameter(
        0.2,
        doc="Radius of the vehicle's bounding sphere, including rotors, for obstacle avoidance.",
        unit="m",
        above=0.0,
        maximum=10.0,
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Vehicle(VehicleParameters):
    """The inverse of the throttle curve; thrust is the sum over the motors, along body z."""

    owner = "vehicle"

    def specific_thrust(self, *, a_WB_W: Array, v_WB_W: Array, R_WB: Array) -> Array:
        """Return the specific thrust (n,) [m/s^2] of motions through still air.

        The component along body z of the specific force a + R D R' v + g e3 - k_h (v_x^2 + v_y^2)
        z_B, with D depending on the thrust. Shapes: ``a_WB_W`` and ``v_WB_W`` (n, 3), ``R_WB``
        (n, 3, 3).
        """
        along = np.einsum("ni,ni->n", R_WB[:, :, 2], a_WB_W) + self.gravity * R_WB[:, 2, 2]
        v_WB_B = np.einsum("nji,nj->ni", R_WB, v_WB_W)
        lift = self.translational_lift * np.sum(v_WB_B[:, :2] ** 2, axis=1)
        still = np.asarray(along + per_axis(self.drag)[2] * v_WB_B[:, 2] - lift)
        rotors = per_axis(self.rotor_drag)[2]
        if rotors == 0.0:
            return still
        root = root_of_thrust(still, 0.5 * rotors * v_WB_B[:, 2] / math.sqrt(self.gravity))
        return np.where(still > 0.0, root * root, still)

    def throttle_for(self, thrust: float) -> float:
        """Return the throttle that gives a total thrust [N] (paper, section 2.1).

        Raises :class:`.ArgumentError` if no throttle in [0, 1] does.
        """
        lowest, highest = self.thrust(0.0), self.thrust(1.0)
        if not lowest <= thrust <= highest:
            raise ArgumentError(
                "thrust",
                thrust,
                f"the thrust at a throttle in [0, 1], {lowest:.6g} N to {highest:.6g} N",
            )
        a, b, c = self.thrust_curve
        return inverse_throttle_curve(a, b, c, thrust / self.motor_count)

    def nearest_throttle(self, thrust: float) -> float:
        """Return the throttle in [0, 1] whose total thrust is nearest to a given thrust [N]."""
        return self.throttle_for(min(max(thrust, self.thrust(0.0)), self.thrust(1.0)))

    @property
    def hover_throttle(self) -> float:
        """Throttle at which the thrust equals the weight."""
        return self.throttle_for(self.mass * self.gravity)


@functools.lru_cache  # nodes of one process use the same vehicle
def _vehicle(**parameters: Any) -> Vehicle:
    return Vehicle(**parameters)


def throttle_curve(a: float, b: float, c: float, throttle: float) -> float:
    """Return the thrust a s^2 + b s + c at a throttle s, in the units of the curve."""
    return (a * throttle + b) * throttle + c


def inverse_throttle_curve(a: float, b: float, c: float, thrust: float) -> float:
    """Return the throttle s in [0, 1] for which a s^2 + b s + c is nearest to a thrust.

    The paper's root (section 2.1), multiplied out so that it neither cancels nor divides by a = 0.
    Units follow the curve. Compiled code uses :mod:`.model.rollout`; this version is plain Python,
    so that reading a configuration does not load Numba.
    """
    missing = c - thrust
    if missing >= 0.0:  # throttle 0 has the requested thrust or more
        return 0.0
    root = math.sqrt(b * b - 4.0 * a * missing)
    return min(-2.0 * missing / (b + root), 1.0)


def root_of_thrust(still: Any, b: Any) -> Any:
    """Return sqrt(T) for a thrust T = still + 2 b sqrt(T) [m/s^2], caused by rotor drag.

    For numbers or arrays; compiled code uses :mod:`quad_mpc_ros.control.model.parameters`.
    """
    return np.maximum(b + np.sqrt(np.maximum(b * b + still, 0.0)), 0.0)


def outline(arm: float) -> tuple[Array, Array]:
    """Return two beams (2, 2, 3) and four rotors (4, points, 3) in the body, for figures [m]."""
    directions = np.radians([45.0, 135.0, 225.0, 315.0])
    hubs = arm * np.column_stack((np.cos(directions), np.sin(directions), np.zeros(4)))
    turn = np.linspace(0.0, 2.0 * np.pi, _ROTOR_POINTS, endpoint=False)
    disc = 0.6 * arm * np.column_stack((np.cos(turn), np.sin(turn), np.zeros(_ROTOR_POINTS)))
    return hubs[[[0, 2], [1, 3]]], hubs[:, None] + disc
