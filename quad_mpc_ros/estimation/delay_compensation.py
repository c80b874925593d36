"""From an odometry to the situation in which the next command will act."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.compilation import compiled
from quad_mpc_ros.estimation.command_history import CommandHistory, acting_between
from quad_mpc_ros.estimation.disturbance_ekf import Memory, VehicleEstimator, follow, start_at
from quad_mpc_ros.lie import Array, kernels
from quad_mpc_ros.model.rollout import (
    NO_DISTURBANCE,
    Disturbance,
    Model,
    Motion,
    advance,
    model_of,
    motion,
    read_odometry,
)
from quad_mpc_ros.model.samples import OdometrySample
from quad_mpc_ros.model.state import Input
from quad_mpc_ros.mpc_config import MpcConfig
from quad_mpc_ros.ocp.situation import Situation

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
        self._follows = self._learning or self._model.thrust_time_constant > 0.0
        self._now = motion(1)
        self._previous_ns: int | None = None
        # Of the previous odometry: what is predicted overwrites the state.
        self._R_WB, self._w_WB_B = np.eye(3), np.zeros(3)
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
            self._previous_ns = None
            self._was_idle = True
        self._engaged = engaged

    def predict(self, odometry: OdometrySample) -> Situation:
        """Return the situation in which a command sent now will begin to act.

        Its motion is overwritten by the next.
        """
        stamp_ns = odometry.stamp_ns
        previous_ns = self._followed_from(stamp_ns)
        if previous_ns is None:
            self._estimator.begin()
        _arrive(
            odometry.p_WB,
            odometry.q_WB_xyzw,
            odometry.v_WB_B,
            odometry.w_WB_B,
            *self._now,
            self._follows,
            self._learning,
            previous_ns is None,
            stamp_ns if previous_ns is None else previous_ns,
            stamp_ns,
            self._engaged,
            self._settling_ns(odometry),
            *self._model,
            *self._estimator.memory,
            *self._history.rows,
            *self._history.room,
            *self._bounds,
            self._R_WB,
            self._w_WB_B,
        )
        self._previous_ns = stamp_ns
        d, model = self.disturbance, self._estimator.model
        acts_ns = stamp_ns + self._delay_ns
        if self._delay_ns > 0:
            acting = self._history.between(stamp_ns, acts_ns)
            advance(
                model,
                d.a_W,
                d.thrust_scale,
                acting.commands,
                acting.durations,
                _LONGEST,
                self._now,
            )
        return Situation(acts_ns, self._now, self._sent.throttle, model, d)

    def _followed_from(self, stamp_ns: int) -> int | None:
        """Return the stamp of the odometry from which there is something to be learned to another.

        Not across a long silence, nor from a clock to one that was set.
        """
        previous_ns = self._previous_ns
        if previous_ns is not None and 0 <= stamp_ns - previous_ns <= _LONGEST_GAP_NS:
            return previous_ns
        return None

    def _settling_ns(self, odometry: OdometrySample) -> int:
        """Return for how long commands must have acted before the vehicle is judged by them."""
        if not self._was_idle:
            return 0
        return _SPOOLING_NS if odometry.speed < _REST_SPEED else _SETTLING_NS


@compiled
def _arrive(
    # the odometry
    p_WB: Array,
    q_WB_xyzw: Array,
    v_WB_B: Array,
    w_WB_B: Array,
    # its state
    p_now: Array,
    v_now: Array,
    R_now: Array,
    actuators_now: Array,
    follows: bool,
    learning: bool,
    is_first: bool,
    previous_ns: int,
    stamp_ns: int,
    engaged: bool,
    settling_ns: int,
    # the model
    a: float,
    b: float,
    c: float,
    drag: float,
    gravity: float,
    thrust_time_constant: float,
    rate_time_constant: float,
    # the estimator's memory
    x: Array,
    P: Array,
    throttle: Array,
    rate_lag: Array,
    flown: Array,
    # the commands sent, and room for those that acted
    acts_ns: NDArray[np.int64],
    sent: Array,
    count: int,
    durations: Array,
    commands: Array,
    throttle_min: float,
    throttle_max: float,
    # of the previous odometry
    R_before: Array,
    w_before: Array,
) -> None:
    """Read an odometry, and bring up to it what nobody measures."""
    now = Motion(p_now, v_now, R_now, actuators_now)
    read_odometry(p_WB, q_WB_xyzw, v_WB_B, w_WB_B, now)
    if follows and is_first:
        start_at(x, P, v_now[0])
    elif follows:
        acted = acting_between(acts_ns, sent, count, previous_ns, stamp_ns, durations, commands)
        # What acted is not known, or has not acted for long enough.
        frozen = not engaged or count == 0 or acts_ns[0] > previous_ns - settling_ns
        for k in range(acted):
            frozen |= not throttle_min < commands[k, 0] < throttle_max
        follow(
            Model(a, b, c, drag, gravity, thrust_time_constant, rate_time_constant),
            Memory(x, P, throttle, rate_lag, flown),
            durations[:acted],
            commands[:acted],
            R_before,
            w_before,
            R_now[0],
            w_WB_B,
            v_now[0],
            learning,
            frozen,
        )
    actuators_now[0, 0] = throttle[0]
    kernels.store_matrix(kernels.matrix(R_now[0]), R_before)
    kernels.store_vector(kernels.vector(w_WB_B), w_before)
