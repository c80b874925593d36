"""The time constants of the body rates, learned from how they follow their commands.

Roll and pitch share one, their mean, and keep their ratio; yaw has its own: it is turned by the
drag of the rotors, several times slower as a rule, and would pull the others' to its side.

A rate loop is no first-order lag, only like one as long as commands change slowly: at first it
hardly answers, and commands that follow the noise of a velocity ask for little else. So it is not
asked what a rate does within one period, but whether a model that runs beside the vehicle, and is
led to the measured rates slowly only, stays with it,

    w <- c + exp(-t / tau) (w - c),   w <- w + l (measured - w),   l = 1 - exp(-t / 0.3 s)

with the derivative of w by tau beside it. By that derivative a filter of one state for each tau
learns from measured - w, both low-passed alike, for slow motions are what the horizon is of.
"""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.compilation import compiled
from quad_mpc_ros.estimation.command_history import Acting
from quad_mpc_ros.lie import Array, kernels
from quad_mpc_ros.model.actuators import first_order_lag, first_order_lag_slopes
from quad_mpc_ros.model.parameters import RATE_TIME_CONSTANTS

# One vector: time constants and variances of roll and pitch, of yaw; the model's rates, their
# derivatives; how far they are off and the derivatives, low-passed.
_ROLL_PITCH, _YAW, _RATE, _SLOPE, _OFF, _OFF_SLOPE, _SIZE = 0, 2, 4, 7, 10, 13, 16
_VARIANCE = 1  # beside its time constant

_SPREAD = 0.5  # of a time constant at the start, relative
_WALK = 0.1  # relative, 1 / sqrt(s)
_NOISE = 0.1  # rad/s, of a measured rate against the model
_LEADING, _SMOOTHING = 0.3, 0.1  # s
_FASTEST, _SLOWEST_YAW = 0.5, 6.0  # bounds, as factors on what is configured


class RateLags:
    """Follows the body rates from odometry to odometry. A lag of zero is none and stays."""

    def __init__(self, nominal: Array, *, slower: float = 1.0) -> None:
        """``nominal`` are the configured parameters (29,).

        By ``slower`` of it the time constant of roll and pitch may be longer than configured.
        """
        roll, pitch, yaw = nominal[RATE_TIME_CONSTANTS].tolist()
        shared = 0.5 * (roll + pitch)
        self._nominal = np.array([shared, yaw])
        self._lags = max(shared, yaw) > 0.0
        self._slowest = np.array([1.0 + slower, _SLOWEST_YAW])
        # Of the shared one what each axis has.
        self._shares = np.array([roll, pitch, yaw]) / np.array([shared or 1.0] * 2 + [yaw or 1.0])
        self._state = np.zeros(_SIZE)
        self.reset()

    def lags(self) -> Array:
        """Return the time constants of roll, pitch and yaw (3,) [s]."""
        shared, yaw = self._state.item(_ROLL_PITCH), self._state.item(_YAW)
        return np.asarray(self._shares * (shared, shared, yaw))

    def write(self, parameters: Array) -> None:
        """Write the time constants of roll, pitch and yaw into the parameters (29,)."""
        parameters[RATE_TIME_CONSTANTS] = self.lags()

    @property
    def roll_pitch(self) -> float:
        """The time constant that roll and pitch have on average [s]."""
        return float(self._state[_ROLL_PITCH])

    @property
    def yaw(self) -> float:
        """The time constant of yaw [s]."""
        return float(self._state[_YAW])

    def reset(self) -> None:
        """Believe the configured time constants again, and that loosely."""
        for place, nominal in zip((_ROLL_PITCH, _YAW), self._nominal, strict=True):
            self._state[place] = nominal
            self._state[place + _VARIANCE] = (_SPREAD * nominal) ** 2

    def memory(self) -> Array:
        """Return what is believed."""
        return self._state[:_RATE].copy()

    def recall(self, memory: Array) -> None:
        """Believe again what was believed; the rates are those of now."""
        self._state[:_RATE] = memory

    def update(self, *, acting: Acting, measured: Array, learns: bool, follows: bool) -> None:
        """Go on to measured rates (3,), under the commands that acted since those before.

        Without ``learns`` the time constants stay; what comes before it ``follows`` is forgotten.
        """
        if self._lags:
            _update(
                state=self._state,
                nominal=self._nominal,
                slowest=self._slowest,
                shares=self._shares,
                commands=acting.commands,
                durations=acting.durations,
                measured=measured,
                learns=learns,
                follows=follows,
            )


@compiled
def _update(
    state: Array,
    nominal: Array,
    slowest: Array,
    shares: Array,
    commands: Array,
    durations: Array,
    measured: Array,
    learns: bool,
    follows: bool,
) -> None:
    duration = durations.sum()
    lead = 1.0 - math.exp(-duration / _LEADING) if follows else 1.0
    share = 1.0 - math.exp(-duration / _SMOOTHING)
    for axis in range(3):
        place, group = (_YAW, 1) if axis == 2 else (_ROLL_PITCH, 0)
        for k in range(len(durations)):
            _follow(state, axis, shares[axis] * state[place], commands[k, 1 + axis], durations[k])
        off, slope = measured[axis] - state[_RATE + axis], state[_SLOPE + axis]
        state[_OFF + axis] += share * (off - state[_OFF + axis])
        state[_OFF_SLOPE + axis] += share * (slope - state[_OFF_SLOPE + axis])
        state[_RATE + axis] += lead * off
        state[_SLOPE + axis] = (1.0 - lead) * slope
        if not follows:
            state[_OFF + axis] = state[_OFF_SLOPE + axis] = 0.0
        elif learns:
            state[place + _VARIANCE] += _walked(axis, nominal[group]) * duration
            bounds = _FASTEST * nominal[group], slowest[group] * nominal[group]
            _correct(state, place, axis, shares[axis], bounds)


@compiled
def _walked(axis: int, nominal: float) -> float:
    """Return the growth of a variance per second, for each of the axes that share it."""
    return (_WALK * nominal) ** 2 * (1.0 if axis == 2 else 0.5)


@compiled
def _follow(state: Array, axis: int, lag: float, command: float, duration: float) -> None:
    """Move the model of an axis on under a command."""
    decay, _share = first_order_lag(lag, duration)
    decay_slope, _share_slope = first_order_lag_slopes(lag, duration)
    off = state[_RATE + axis] - command
    state[_SLOPE + axis] = decay * state[_SLOPE + axis] + decay_slope * off
    state[_RATE + axis] = command + decay * off


@compiled
def _correct(
    state: Array, place: int, axis: int, share: float, bounds: tuple[float, float]
) -> None:
    """Correct a time constant by what an axis with a share in it is off, and with it the model."""
    variance, before = state[place + _VARIANCE], state[place]
    slope = share * state[_OFF_SLOPE + axis]
    gain = variance * slope / (slope**2 * variance + _NOISE**2)
    state[place] = kernels.clamp(before + gain * state[_OFF + axis], bounds[0], bounds[1])
    state[place + _VARIANCE] = variance - gain * slope * variance
    change = state[place] - before
    state[_OFF + axis] -= slope * change
    state[_RATE + axis] += share * state[_SLOPE + axis] * change
