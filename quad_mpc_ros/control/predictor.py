"""From an odometry to the situation in which the next command will act."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.control.command_history import CommandHistory
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.estimator import VehicleEstimator
from quad_mpc_ros.control.prediction import (
    NO_DISTURBANCE,
    Disturbance,
    Motion,
    advance,
    model_of,
    motion_of,
)
from quad_mpc_ros.control.situation import Situation
from quad_mpc_ros.core.messages import Array, OdometrySample
from quad_mpc_ros.core.state import Input

# Longest stretch predicted at once; the error is of the third order in the turn of a stretch.
_LONGEST = 0.005
# Beyond it what the vehicle did between two odometries is not known well enough to learn from.
_LONGEST_GAP_NS = 500_000_000
# How long commands must have acted before they teach something, once they had not acted: the
# actuators are on their way from wherever another had them. And longer while the vehicle rests:
# autopilots let the motors spool up for a second before they let them do as commanded.
_SETTLING_NS, _SPOOLING_NS = 300_000_000, 1_500_000_000
_REST_SPEED = 0.1


class StatePredictor:
    """Follows the vehicle through the commands sent, and predicts across the input delay."""

    def __init__(self, config: MpcConfig) -> None:
        vehicle = config.vehicle()
        self._model = model_of(
            vehicle,
            rate_time_constant=config.rate_time_constant,
            thrust_time_constant=config.thrust_time_constant,
        )
        self._learning = config.estimate_disturbance
        self._delay_ns = round(config.input_delay * 1e9)
        hover = Input(throttle=vehicle.hover_throttle, w_WB_B=np.zeros(3))
        self._history = CommandHistory(delay_ns=self._delay_ns, initial=hover)
        self._sent = hover
        self._engaged, self._was_idle = True, False
        self._estimator = VehicleEstimator(
            self._model, throttle=hover.throttle, learning=self._learning
        )
        self._previous: tuple[OdometrySample, Array] | None = None
        self.reconfigure(config)

    def reconfigure(self, config: MpcConfig) -> None:
        """Take over changed bounds."""
        self._bounds = (config.throttle_min, config.throttle_max)

    @property
    def disturbance(self) -> Disturbance:
        """The present estimate of the disturbance."""
        return self._estimator.disturbance if self._learning else NO_DISTURBANCE

    def record(self, command: Input, *, stamp_ns: int) -> None:
        """Remember a command by the stamp of the odometry that it answers."""
        self._sent = command
        self._history.record(command, stamp_ns=stamp_ns)

    def engage(self, engaged: bool) -> None:
        """Tell whether commands act on the vehicle; they are supposed to.

        While they do not, nothing is learned, and what was learned is kept. What is sent in that
        time is remembered all the same: who tells may be late.
        """
        if engaged and not self._engaged:
            self._history.forget()
            self._previous = None
            self._was_idle = True
        self._engaged = engaged

    def predict(self, odometry: OdometrySample) -> Situation:
        """Return the situation in which a command sent now will begin to act."""
        now = motion_of(odometry)
        self._follow(odometry, now)
        now.actuators[0, 0] = self._estimator.throttle
        acts_ns = odometry.stamp_ns + self._delay_ns
        d, model = self.disturbance, self._estimator.model
        for interval in self._history.between(odometry.stamp_ns, acts_ns):
            advance(
                model,
                d.a_W,
                d.thrust_scale,
                interval.command.vector(),
                interval.duration,
                _LONGEST,
                now,
            )
        return Situation(
            stamp_ns=acts_ns,
            motion=now,
            throttle_sent=self._sent.throttle,
            model=model,
            disturbance=d,
        )

    def _follow(self, odometry: OdometrySample, now: Motion) -> None:
        """Bring what nobody measures up to an odometry."""
        if not self._learning and self._model.thrust_time_constant == 0.0:
            return  # nothing to follow
        R_WB = now.R_WB[0].copy()  # what is predicted from here on overwrites it
        if self._previous is None or not self._follows(odometry, self._previous[0]):
            self._estimator.start(now.v_WB_W[0])
        else:
            before, R_before = self._previous
            acting = list(self._history.between(before.stamp_ns, odometry.stamp_ns))
            low, high = self._bounds
            saturated = any(not low < interval.command.throttle < high for interval in acting)
            self._estimator.follow(
                R_before=R_before,
                w_before=before.w_WB_B,
                R_after=R_WB,
                w_after=odometry.w_WB_B,
                v_after=now.v_WB_W[0],
                acting=acting,
                frozen=saturated or not self._have_acted(before.stamp_ns, now.v_WB_W[0]),
            )
        self._previous = (odometry, R_WB)

    @staticmethod
    def _follows(odometry: OdometrySample, before: OdometrySample) -> bool:
        """Whether there is something to be learned from one odometry to the next.

        Not across a long silence, nor from a clock to one that was set.
        """
        return 0 <= odometry.stamp_ns - before.stamp_ns <= _LONGEST_GAP_NS

    def _have_acted(self, time_ns: int, v_WB_W: Array) -> bool:
        """Whether the commands sent from here act, and have for long enough to be judged by."""
        settling_ns = 0
        if self._was_idle:
            resting = float(v_WB_W @ v_WB_W) < _REST_SPEED**2
            settling_ns = _SPOOLING_NS if resting else _SETTLING_NS
        return self._engaged and self._history.knows(time_ns - settling_ns)
