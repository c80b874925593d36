# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The multirotor of rotorpy as a plant: independent motors, aerodynamics and rate loop.

S. Folk, J. Paulos, V. Kumar, "RotorPy: A Python-based Multirotor Simulator with Aerodynamics for
Education and Research", 2023, https://github.com/spencerfolk/rotorpy. rotorpy has the frames of
this package: world z up, body FLU, quaternions x, y, z, w of body to world.
"""

from __future__ import annotations

import importlib
import math
from typing import Any

import numpy as np

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.model.state import Input, State, odometry_from_state
from quad_mpc_ros.simulation.optional_plants import RotorpyParameters
from quad_mpc_ros.simulation.plant import DelayedPlant

# The rate loop of rotorpy runs once per step; below 500 Hz it would be unrealistic.
_MAX_STEP = 0.002
_INTEGRATOR = {"method": "RK45", "rtol": 1e-6, "atol": 1e-9}


class RotorpyPlant(DelayedPlant):
    """AscTec Hummingbird of rotorpy, commanded by collective thrust and body rates (``cmd_ctbr``).

    Inertia, rotors, motor lag and aerodynamics are rotorpy's; mass and gravity are configured. The
    configured thrust curve converts the throttle to a thrust, like the mixer of an autopilot.
    """

    def __init__(self, config: RotorpyParameters) -> None:
        super().__init__(config)
        self._config = config
        self._longest_step_ns = round(1e9 * min(config.integration_step, _MAX_STEP))
        self._multirotor = _multirotor(config, mass=self._vehicle.mass)
        self._u = Input(
            throttle=config.initial_throttle, w_WB_B=np.array(config.initial_body_rates)
        )
        self._state = self._start()

    @property
    def v_WB_W(self) -> Array:
        """True velocity (3,) [m/s]."""
        return self._state["v"]

    @property
    def state(self) -> State:
        """The true state."""
        R_WB = so3.rotation_from_quaternion_xyzw(self._state["q"])
        return State(p_WB=self._state["x"].copy(), v_WB_B=R_WB.T @ self._state["v"], R_WB=R_WB)

    def odometry(self, stamp_ns: int) -> OdometrySample:
        """Return the true odometry with the given stamp."""
        return odometry_from_state(
            self.state,
            w_WB_B=self._state["w"].copy(),
            stamp_ns=stamp_ns,
            frame_id=self._config.frame_id,
            child_frame_id=self._config.child_frame_id,
        )

    def _follow(self, command: Input) -> None:
        self._u = command

    def _integrate(self, duration_ns: int) -> None:
        steps = -(-duration_ns // self._longest_step_ns)
        duration = duration_ns * 1e-9 / steps
        control = {"cmd_thrust": self._vehicle.thrust(self._u.throttle), "cmd_w": self._u.w_WB_B}
        self._state["wind"] = self._wind.velocity_W
        for _ in range(steps):
            self._state = self._multirotor.step(self._state, control, duration)

    def _start(self) -> dict[str, Array]:
        config = self._config
        thrust = max(self._vehicle.thrust(config.initial_throttle), 0.0)
        rotor_count = self._multirotor.num_rotors
        rotor_speed = math.sqrt(thrust / rotor_count / self._multirotor.k_eta)
        rotor_speed = min(rotor_speed, self._multirotor.rotor_speed_max)
        q_WB_xyzw = np.array(config.initial_attitude)
        return {
            "x": np.array(config.initial_position),
            "v": np.array(config.initial_velocity),
            "q": q_WB_xyzw / np.linalg.norm(q_WB_xyzw),
            "w": np.array(config.initial_body_rates),
            "wind": self._wind.velocity_W,
            "rotor_speeds": np.full(rotor_count, rotor_speed),
        }


def _multirotor(config: RotorpyParameters, *, mass: float) -> Any:
    """Return rotorpy's vehicle; raises :class:`UserError` if rotorpy is not installed."""
    try:
        multirotor = importlib.import_module("rotorpy.vehicles.multirotor")
        hummingbird = importlib.import_module("rotorpy.vehicles.hummingbird_params")
    except ImportError as error:
        raise UserError(
            f"simulator.plant: rotorpy cannot be imported ({error}); "
            f"install it with: pip install 'quad_mpc_ros[rotorpy]'"
        ) from error
    made = multirotor.Multirotor(
        {**hummingbird.quad_params, "mass": mass, "k_w": config.rotorpy_rate_gain},
        control_abstraction="cmd_ctbr",
        enable_ground=True,
        integrator_kwargs=_INTEGRATOR,
    )
    made.weight = np.array([0.0, 0.0, -mass * config.gravity])
    return made
