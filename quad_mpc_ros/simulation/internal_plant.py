"""The package's own vehicle: true state, actuators, wind, ground.

Its equations and its integrator are not those of ``model/rollout.py``, by which the controller
predicts: they are written twice on purpose, so that a mistake in one of them shows in flight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.configuration import parameter
from quad_mpc_ros.lie import Array, so3
from quad_mpc_ros.model.samples import OdometrySample
from quad_mpc_ros.model.state import Input, State, odometry_from_state
from quad_mpc_ros.simulation.actuators import ActuatorLag
from quad_mpc_ros.simulation.dynamics import DYNAMICS, InputCourse, integrate_along
from quad_mpc_ros.simulation.parameters import LONGEST_TIME_CONSTANT, PlantParameters
from quad_mpc_ros.simulation.plant import DelayedPlant
from quad_mpc_ros.simulation.wind import in_wind

# Steps per time constant, for the integrator to follow a lag, and the shortest step for that.
_STEPS_PER_LAG = 10
_SHORTEST_STEP = 5e-4


@dataclass(frozen=True, kw_only=True)
class InternalParameters(PlantParameters):
    """Its own: which equations of motion, and how the actuators lag."""

    dynamics: str = parameter(
        "rigid_body",
        doc="Equations of motion: the true rigid body, or the paper's Eq. (3) literally.",
        choices=("rigid_body", "paper"),
    )
    rate_time_constant: float = parameter(
        0.0,
        doc="First-order lag of the body rates behind the commanded ones.",
        unit="s",
        minimum=0.0,
        maximum=LONGEST_TIME_CONSTANT,
    )
    thrust_time_constant: float = parameter(
        0.0,
        doc="First-order lag of the throttle that makes the thrust behind the commanded one.",
        unit="s",
        minimum=0.0,
        maximum=LONGEST_TIME_CONSTANT,
    )


class InternalPlant(DelayedPlant):
    """Integrates the equations of motion between any two times with the commands in force.

    Steps of the integrator end where a command begins to act and where the gusts change.
    """

    def __init__(self, config: InternalParameters) -> None:
        super().__init__(config)
        self._config = config
        self._weight = self._vehicle.mass * self._vehicle.gravity
        self._lag = ActuatorLag(
            rate_time_constant=config.rate_time_constant,
            thrust_time_constant=config.thrust_time_constant,
            initial=Input(
                throttle=config.initial_throttle, w_WB_B=np.array(config.initial_body_rates)
            ),
        )
        self._dynamics = DYNAMICS[config.dynamics]
        following = max(self._lag.shortest_time_constant / _STEPS_PER_LAG, _SHORTEST_STEP)
        self._longest_step_ns = round(1e9 * min(config.integration_step, following))
        R_WB = so3.rotation_from_quaternion_xyzw(config.initial_attitude)
        self.state = State(
            p_WB=np.array(config.initial_position),
            v_WB_B=R_WB.T @ np.array(config.initial_velocity),
            R_WB=R_WB,
        )
        """The true state."""

    @property
    def v_WB_W(self) -> Array:
        """True velocity (3,) [m/s]."""
        return self.state.v_WB_W

    @property
    def input(self) -> Input:
        """The true throttle and body rates of the actuators."""
        return self._lag.u

    def odometry(self, stamp_ns: int) -> OdometrySample:
        """Return the true odometry under a stamp."""
        return odometry_from_state(
            self.state,
            w_WB_B=self._lag.u.w_WB_B if not self._on_ground() else np.zeros(3),
            stamp_ns=stamp_ns,
            frame_id=self._config.frame_id,
            child_frame_id=self._config.child_frame_id,
        )

    def _follow(self, command: Input) -> None:
        self._lag.follow(command)

    def _integrate(self, duration_ns: int) -> None:
        steps = -(-duration_ns // self._longest_step_ns)
        duration = duration_ns * 1e-9 / steps
        dynamics = self._dynamics
        if self._wind.blows:
            dynamics = in_wind(dynamics, self._wind.velocity_W)
        for _ in range(steps):
            course = self._lag.course(duration)
            self._lag.finish(course)
            if self._rests(course):
                self._lag.stop_turning()
                continue
            self.state = self._held_by_ground(
                integrate_along(
                    self.state, course, self._vehicle, dynamics=dynamics, duration=duration
                )
            )

    def _held_by_ground(self, x: State) -> State:
        """Let the ground stop what would fall through it: at rest, level, heading kept."""
        if x.p_WB[2] > 0.0 or (x.p_WB[2] == 0.0 and x.v_WB_W[2] > 0.0):
            return x
        self._lag.stop_turning()
        yaw = math.atan2(x.R_WB[1, 0], x.R_WB[0, 0])
        return State(
            p_WB=np.array([x.p_WB[0], x.p_WB[1], 0.0]),
            v_WB_B=np.zeros(3),
            R_WB=so3.exp([0.0, 0.0, yaw]),
        )

    def _rests(self, course: InputCourse) -> bool:
        """Whether the ground carries what the thrust does not: no command turns it there."""
        if not self._on_ground():
            return False
        throttle = max(course.start.throttle, course.end.throttle)
        return self._vehicle.thrust(throttle) <= self._weight

    def _on_ground(self) -> bool:
        """Known here; the controller has to find it out (``estimation/contact.py``)."""
        return bool(self.state.p_WB[2] <= 0.0 and not self.state.v_WB_B.any())
