# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The plant ``internal``: true state, actuators, wind, ground.

Equations and integrator are independent of the controller's (``control/model/rollout.py``), so
that flights reveal errors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.configuration import parameter, per_axis
from quad_mpc_ros.configuration.records import RecordArray
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.model.state import Input, State
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.simulation import motion
from quad_mpc_ros.simulation.dynamics import VehicleConstants
from quad_mpc_ros.simulation.parameters import LONGEST_TIME_CONSTANT, PlantParameters
from quad_mpc_ros.simulation.plant import DelayedPlant, Measured, PlantInputs, odometry_of

_STEPS_PER_LAG = 10  # of the integrator, per time constant
_SHORTEST_STEP = 5e-4  # s


@dataclass(frozen=True, kw_only=True)
class InternalParameters(PlantParameters):
    """The own parameters of this plant: equations of motion, lags of the actuators."""

    dynamics: str = parameter(
        "rigid_body",
        doc="Equations of motion: the true rigid body, or the paper's Eq. (3) literally.",
        choices=("rigid_body", "paper"),
    )
    rate_time_constant: float | tuple[float, ...] = parameter(
        0.07,
        doc="Lag of the body rates, 1 / proportional gain of the rate loop; 0 disables the lag.",
        unit="s",
        minimum=0.0,
        maximum=LONGEST_TIME_CONSTANT,
    )
    torque_time_constant: float | tuple[float, ...] = parameter(
        0.02,
        doc="Lag of the torque; the rate loop rings if it is above rate_time_constant.",
        unit="s",
        minimum=0.0,
        maximum=LONGEST_TIME_CONSTANT,
    )
    angular_acceleration_max: float | tuple[float, ...] = parameter(
        0.0,
        doc="Largest angular acceleration; 0 disables the limit.",
        unit="rad/s^2",
        minimum=0.0,
    )
    rate_gain: float | tuple[float, ...] = parameter(
        1.0, doc="Ratio of steady to commanded body rates.", minimum=0.0, maximum=10.0
    )
    thrust_time_constant: float = parameter(
        0.04,
        doc="First-order lag of the throttle.",
        unit="s",
        minimum=0.0,
        maximum=LONGEST_TIME_CONSTANT,
    )
    thrust_time_constant_down: float = parameter(
        0.0,
        doc="Lag of a decreasing throttle; 0 uses thrust_time_constant.",
        unit="s",
        minimum=0.0,
        maximum=LONGEST_TIME_CONSTANT,
    )


def constants(config: InternalParameters, vehicle: Vehicle) -> RecordArray[VehicleConstants]:
    """Return the numbers for the compiled code; ``vehicle`` has the true mass."""
    numbers = VehicleConstants.zeros()
    own, lag = numbers[()], config.thrust_time_constant
    own.is_rigid_body = int(config.dynamics == "rigid_body")
    own.gravity = vehicle.gravity
    own.lift[:] = vehicle.thrust_curve
    own.lift *= vehicle.motor_count / vehicle.mass
    own.thrust_time_constant = lag
    own.thrust_time_constant_down = config.thrust_time_constant_down or lag
    own.rate_time_constant[:] = per_axis(config.rate_time_constant)
    own.torque_time_constant[:] = per_axis(config.torque_time_constant)
    bounds = per_axis(config.angular_acceleration_max)
    own.angular_acceleration_max[:] = [most or math.inf for most in bounds]
    own.drag[:] = per_axis(vehicle.drag)
    own.rotor_drag[:] = per_axis(vehicle.rotor_drag)
    own.translational_lift = vehicle.translational_lift
    return numbers


class InternalPlant(DelayedPlant):
    """Integrates the equations of motion between any two times with the active commands.

    Steps of the integrator end where a command begins to act and where the gusts change.
    """

    def __init__(self, config: InternalParameters) -> None:
        super().__init__(config)
        self._config = config
        self._rate_gain = np.array(per_axis(config.rate_gain))
        self._constants = constants(config, self._vehicle)
        own = self._constants[()]
        lags = np.concatenate((own.rate_time_constant, own.torque_time_constant))
        lags = np.append(lags, (own.thrust_time_constant, own.thrust_time_constant_down))
        shortest = min(lags[lags > 0.0], default=math.inf)
        following = max(shortest / _STEPS_PER_LAG, _SHORTEST_STEP)
        self._longest_step_ns = round(1e9 * min(config.integration_step, following))
        self._inputs, self._x = PlantInputs.zeros(), motion.VehicleState.zeros()
        self._x["R_WB"][:] = so3.rotation_from_quaternion_xyzw(config.initial_attitude)
        self._x["p_WB"][:] = config.initial_position
        self._x["v_WB_B"][:] = self._x["R_WB"].T @ np.array(config.initial_velocity)
        for each in (self._x, self._inputs):
            each["throttle"], each["w_WB_B"] = config.initial_throttle, config.initial_body_rates

    @property
    def state(self) -> State:
        """The true state."""
        x = self._x
        return State(p_WB=x["p_WB"].copy(), v_WB_B=x["v_WB_B"].copy(), R_WB=x["R_WB"].copy())

    @property
    def v_WB_W(self) -> Array:
        """True velocity (3,) [m/s]."""
        return np.asarray(self._x["R_WB"] @ self._x["v_WB_B"])

    def odometry(self, stamp_ns: int) -> OdometrySample:
        """Return the true odometry with the given stamp."""
        measured = Measured.zeros()
        motion.measure(self._x, measured)
        return odometry_of(measured, self._config, stamp_ns=stamp_ns)

    def _follow(self, command: Input) -> None:
        followed = self._rate_gain * command.w_WB_B
        self._inputs["throttle"], self._inputs["w_WB_B"] = command.throttle, followed
        if self._config.thrust_time_constant == 0.0:
            self._x["throttle"] = command.throttle
        for axis, lag in enumerate(per_axis(self._config.rate_time_constant)):
            if lag == 0.0:
                self._x["w_WB_B"][axis] = followed[axis]

    def _integrate(self, duration_ns: int) -> None:
        steps = -(-duration_ns // self._longest_step_ns)
        self._inputs["wind_W"] = self.wind_W
        motion.advance(
            self._x,
            inputs=self._inputs,
            vehicle=self._constants,
            steps=steps,
            duration=duration_ns * 1e-9 / steps,
        )
