"""From an odometry to the situation in which the next command will act."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.control.actuators import ActuatorLag, CommandHistory, Interval
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.disturbance import DisturbanceEstimator
from quad_mpc_ros.control.prediction import NO_DISTURBANCE, Disturbance
from quad_mpc_ros.control.situation import Situation
from quad_mpc_ros.core import so3
from quad_mpc_ros.core.messages import Array, OdometrySample
from quad_mpc_ros.core.state import Input, State, state_from_odometry

# Longest stretch predicted at once; the error is of the third order in the turn of a stretch.
_LONGEST = 0.005


class StatePredictor:
    """Follows the actuators through the commands sent, and predicts across the input delay."""

    def __init__(self, config: MpcConfig) -> None:
        self._vehicle = config.vehicle()
        self._delay_ns = round(config.input_delay * 1e9)
        self._lag = ActuatorLag(rate=config.rate_time_constant, thrust=config.thrust_time_constant)
        hover = Input(throttle=self._vehicle.hover_throttle, w_WB_B=np.zeros(3))
        self._history = CommandHistory(delay_ns=self._delay_ns, initial=hover)
        self._sent = hover
        self._throttle = hover.throttle
        self._estimator = (
            DisturbanceEstimator(self._vehicle) if config.estimate_disturbance else None
        )
        self._previous: tuple[int, Array] | None = None
        self.reconfigure(config)

    def reconfigure(self, config: MpcConfig) -> None:
        """Take over changed bounds."""
        self._bounds = (config.throttle_min, config.throttle_max)

    @property
    def disturbance(self) -> Disturbance:
        """The present estimate of the disturbance."""
        return NO_DISTURBANCE if self._estimator is None else self._estimator.estimate

    def record(self, command: Input, *, sent_ns: int) -> None:
        """Remember a command that was sent."""
        self._sent = command
        self._history.record(command, sent_ns=sent_ns)

    def predict(self, odometry: OdometrySample) -> Situation:
        """Return the situation in which a command sent now will begin to act."""
        x = state_from_odometry(odometry)
        self._follow(odometry.stamp_ns, x)
        acts_ns = odometry.stamp_ns + self._delay_ns
        w_WB_B, throttle = odometry.w_WB_B, self._throttle
        for interval in self._history.between(odometry.stamp_ns, acts_ns):
            x, w_WB_B, throttle = self._moved(x, w_WB_B, throttle, interval)
        return Situation(
            stamp_ns=acts_ns,
            x=x,
            w_WB_B=w_WB_B,
            throttle=throttle,
            throttle_sent=self._sent.throttle,
            disturbance=self.disturbance,
        )

    def _follow(self, stamp_ns: int, x: State) -> None:
        """Bring the throttle, which nobody measures, and the disturbance up to an odometry."""
        if self._estimator is None and self._lag.thrust == 0.0:
            return  # nothing to follow
        axis = x.R_WB[:, 2]
        if self._previous is not None:
            previous_ns, previous_axis = self._previous
            impulse = 0.0
            saturated = False
            for interval in self._history.between(previous_ns, stamp_ns):
                self._throttle, mean = self._lag.throttle(self._throttle, interval)
                impulse += interval.duration * self._vehicle.thrust(mean)
                saturated |= not self._bounds[0] < interval.command.throttle < self._bounds[1]
            duration = (stamp_ns - previous_ns) * 1e-9
            if self._estimator is not None:
                self._estimator.update(
                    v_WB_W=x.v_WB_W,
                    thrust_axis_W=_mean_axis(previous_axis, axis),
                    thrust=impulse / duration if duration > 0.0 else 0.0,
                    duration=duration,
                    frozen=saturated,
                )
        self._previous = (stamp_ns, axis)

    def _moved(
        self, x: State, w_WB_B: Array, throttle: float, interval: Interval
    ) -> tuple[State, Array, float]:
        """Return state, rate and throttle after an interval, in short stretches."""
        d = self.disturbance
        stretches = max(1, -(-round(interval.duration * 1e9) // round(_LONGEST * 1e9)))
        part = Interval(duration=interval.duration / stretches, command=interval.command)
        dt = part.duration
        p, v, R = x.p_WB, x.v_WB_W, x.R_WB
        for _ in range(stretches):
            w_WB_B, mean_rate = self._lag.body_rate(w_WB_B, part)
            throttle, mean_throttle = self._lag.throttle(throttle, part)
            half = so3.exp(0.5 * dt * mean_rate)
            R_mid = R @ half
            a = d.thrust_scale * self._vehicle.thrust(mean_throttle) / self._vehicle.mass
            acceleration = a * R_mid[:, 2] + d.a_W - self._vehicle.drag * v
            acceleration[2] -= self._vehicle.gravity
            p = p + dt * v + 0.5 * dt * dt * acceleration
            v = v + dt * acceleration
            R = R_mid @ half
        return State(p_WB=p, v_WB_B=R.T @ v, R_WB=R), w_WB_B, throttle


def _mean_axis(before: Array, after: Array) -> Array:
    """Return the mean of a direction that turned evenly from one to another (Simpson)."""
    middle = before + after
    length = float(np.sqrt(middle @ middle))
    if length < 1e-6:
        return np.asarray(after)
    return np.asarray((before + after + 4.0 * middle / length) / 6.0)
