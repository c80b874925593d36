"""The simulated vehicle: true state, command in force, ground."""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.core import so3
from quad_mpc_ros.core.dynamics import DYNAMICS, integrate
from quad_mpc_ros.core.messages import CommandSample, OdometrySample
from quad_mpc_ros.core.state import Input, State, odometry_from_state
from quad_mpc_ros.simulation.config import SimulatorConfig


class Plant:
    """Integrates the equations of motion between any two times with the command in force.

    It starts at rest on the ground, idling. Time is counted in nanoseconds from its start.
    """

    def __init__(self, config: SimulatorConfig) -> None:
        self._config = config
        self._vehicle = config.vehicle()
        self._dynamics = DYNAMICS[config.dynamics]
        self._longest_step_ns = round(config.integration_step * 1e9)
        self._x = State(
            p_WB=np.array(config.initial_position),
            v_WB_B=np.zeros(3),
            R_WB=so3.exp([0.0, 0.0, config.initial_yaw]),
        )
        self._u = Input(throttle=0.0, w_WB_B=np.zeros(3))
        self._time_ns = 0

    @property
    def time_ns(self) -> int:
        """Time of the state, from the start of the plant."""
        return self._time_ns

    @property
    def state(self) -> State:
        """The true state."""
        return self._x

    def apply(self, command: CommandSample) -> None:
        """Put a command in force from now on. The throttle saturates; nonsense is ignored."""
        if not (math.isfinite(command.throttle) and np.isfinite(command.w_WB_B).all()):
            return
        self._u = Input(
            throttle=min(max(command.throttle, 0.0), 1.0), w_WB_B=command.w_WB_B.copy()
        )

    def advance_to(self, time_ns: int) -> None:
        """Integrate to a time; a time already past changes nothing."""
        remaining = time_ns - self._time_ns
        if remaining <= 0:
            return
        steps = -(-remaining // self._longest_step_ns)
        duration = remaining * 1e-9 / steps
        for _ in range(steps):
            if self._rests():
                break  # nor will it move while this command is in force
            self._x = self._held_by_ground(
                integrate(
                    self._x, self._u, self._vehicle, dynamics=self._dynamics, duration=duration
                )
            )
        self._time_ns = time_ns

    def odometry(self, stamp_ns: int) -> OdometrySample:
        """Return the true odometry under a stamp."""
        return odometry_from_state(
            self._x,
            w_WB_B=self._u.w_WB_B if not self._on_ground(self._x) else np.zeros(3),
            stamp_ns=stamp_ns,
            frame_id=self._config.frame_id,
            child_frame_id=self._config.child_frame_id,
        )

    def _held_by_ground(self, x: State) -> State:
        """Let the ground stop what would fall through it: at rest, level, heading kept."""
        if x.p_WB[2] > 0.0 or (x.p_WB[2] == 0.0 and x.v_WB_W[2] > 0.0):
            return x
        yaw = math.atan2(x.R_WB[1, 0], x.R_WB[0, 0])
        return State(
            p_WB=np.array([x.p_WB[0], x.p_WB[1], 0.0]),
            v_WB_B=np.zeros(3),
            R_WB=so3.exp([0.0, 0.0, yaw]),
        )

    def _rests(self) -> bool:
        """Whether the ground carries what the thrust does not: no command turns it there."""
        weight = self._vehicle.mass * self._vehicle.gravity
        return self._on_ground(self._x) and self._vehicle.thrust(self._u.throttle) <= weight

    def _on_ground(self, x: State) -> bool:
        return bool(x.p_WB[2] <= 0.0 and not x.v_WB_B.any())
