"""The multirotor of rotorpy as a plant: somebody else's motors, aerodynamics and rate loop.

S. Folk, J. Paulos, V. Kumar, "RotorPy: A Python-based Multirotor Simulator with Aerodynamics for
Education and Research", 2023, https://github.com/spencerfolk/rotorpy. Its frames are ours: world
z up, body FLU, quaternions x, y, z, w of body to world.
"""

from __future__ import annotations

import importlib
import math
from typing import Any

import numpy as np

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.lie import Array, so3
from quad_mpc_ros.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.model.state import Input, State, odometry_from_state
from quad_mpc_ros.simulation.actuators import CommandDelay, input_from_command
from quad_mpc_ros.simulation.config import SimulatorConfig
from quad_mpc_ros.simulation.wind import Wind

# The rate loop of rotorpy runs once a step; below 500 Hz it is not that of a real vehicle.
_LONGEST_STEP = 0.002
_INTEGRATOR = {"method": "RK45", "rtol": 1e-6, "atol": 1e-9}


class RotorpyPlant:
    """AscTec Hummingbird of rotorpy, commanded by collective thrust and body rates (``cmd_ctbr``).

    Its inertia, rotors, motor lag and aerodynamics are rotorpy's; mass and gravity are the
    parameters'. The throttle becomes the thrust to command by the parameters' thrust curve, as
    in an autopilot's mixer. Wind, gusts and command delay are those of every plant.
    """

    def __init__(self, config: SimulatorConfig) -> None:
        self._config = config
        self._vehicle = config.vehicle()
        self._delay = CommandDelay(config.command_delay)
        self._wind = Wind(config)
        self._longest_step_ns = round(1e9 * min(config.integration_step, _LONGEST_STEP))
        self._multirotor = _multirotor(config, mass=self._vehicle.mass)
        self._u = Input(
            throttle=config.initial_throttle, w_WB_B=np.array(config.initial_body_rates)
        )
        self._state = self._start()
        self._time_ns = 0

    @property
    def time_ns(self) -> int:
        """Time of the state, from the start of the plant."""
        return self._time_ns

    @property
    def state(self) -> State:
        """The true state."""
        R_WB = so3.rotation_from_quaternion_xyzw(self._state["q"])
        return State(p_WB=self._state["x"].copy(), v_WB_B=R_WB.T @ self._state["v"], R_WB=R_WB)

    def apply(self, command: CommandSample) -> None:
        """Take a command that arrives now. The throttle saturates; nonsense is ignored."""
        u = input_from_command(command)
        if u is not None:
            self._delay.put(u, time_ns=self._time_ns)
            self._follow_commands()

    def advance_to(self, time_ns: int) -> None:
        """Integrate to a time; a time already past changes nothing."""
        while self._time_ns < time_ns:
            until_ns = min(time_ns, self._delay.next_ns, self._wind.next_ns)
            self._integrate(until_ns - self._time_ns)
            self._time_ns = until_ns
            self._follow_commands()
            if self._wind.next_ns <= until_ns:
                self._wind.advance_to(until_ns, v_WB_W=self._state["v"])

    def odometry(self, stamp_ns: int) -> OdometrySample:
        """Return the true odometry under a stamp."""
        return odometry_from_state(
            self.state,
            w_WB_B=self._state["w"].copy(),
            stamp_ns=stamp_ns,
            frame_id=self._config.frame_id,
            child_frame_id=self._config.child_frame_id,
        )

    def _follow_commands(self) -> None:
        self._u = self._delay.take(time_ns=self._time_ns) or self._u

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


def _multirotor(config: SimulatorConfig, *, mass: float) -> Any:
    """Return rotorpy's vehicle; raises :class:`UserError` when rotorpy is not installed."""
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
