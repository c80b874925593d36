"""The disturbance EKF: what the model does not know, learned from what the vehicle does.

Between two odometries the velocity and the body rates are predicted with the commands that were
really acting, delayed and lagged. Extended Kalman filters correct by the innovation, what was
measured less what was predicted. The filter of the velocity has the state
x = (v, d, k, tau_s, mu):

- v, the velocity in the world,
- d, an acceleration in the world (wind, drag), and k, a factor on the thrust (mass, battery),
- tau_s, the time constant of the thrust, and mu, the mean of the drag over the axes, which keep
  their proportions: through the velocity's sensitivity to them,

    predict   x <- f(x),  P <- F P F' + Q      F = df/dx, differs from one in the rows of v, d_z, k
    update    K = P H' / (H P H' + r),  x <- x + K (z - H x),  P <- P - K H P      axis by axis

**k and d_z look alike at hover**: only their sum k T/m + d_z = g is told, and they part company as
the vehicle tilts or accelerates. Left to themselves they drift apart, for commands answer the
errors of the measured velocity: thrust that changes and moves nothing looks like little thrust. So
the sum is believed, and of its parts what is likely: winds rise and fall, a lack of thrust lasts.
What of d_z lasts becomes a change of k, over some seconds, and their sum stays the same,

    dd_z/dt = -d_z / T + noise,   dk/dt = (d_z / T) / (T_s/m e3' z_B) + noise.

All else but v are random walks, and everything is clamped to bounds.

**Not every odometry teaches.** On the ground, and where nobody acts on commands, the measured
velocity is believed and nothing learned. Where a command is saturated, or so little that the
ground might carry the vehicle, the velocity alone is corrected. It must not be believed as
measured then: which commands are little depends on the noise of the measurement before, and a
filter that began anew from just those would find too much thrust, 0.1 of the scale with 0.2 m/s of
noise. An odometry that jumps teaches nothing either.

**Drag** is told from a wind by motion: it turns with the velocity, and is known ahead of a turn.
At rest nothing is learned of it. The reference's attitudes were made with another drag, so the
target tilts them by the difference (:mod:`quad_mpc_ros.control.ocp.target`).

A time constant of zero is no lag and stays. The throttle, which nobody measures, is followed
through the lag. The noise of the velocity is found on the way (:mod:`.velocity_noise`), time
constants and offsets of the rates have filters of their own (:mod:`.rate_lags`,
:mod:`.rate_offsets`). The delay of the input is not estimated: ``docs/tuning.md`` says why.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.estimation import (
    rate_lags,
    rate_offsets,
    velocity_filter,
    velocity_noise,
)
from quad_mpc_ros.control.estimation.velocity_filter import (
    DRAG_SPREAD,
    ESTIMATE_SIZE,
    LAG_SPREAD,
    LEARNABLE,
    LEARNED,
    MU,
    PAUSED,
    SCALE_BOUNDS,
    SIZE,
    TAU,
    THROTTLE,
    THROTTLE_SLOPE,
    D,
    K,
    V,
    believe_velocity,
)
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.parameters import (
    DISTURBANCE,
    DRAG,
    GRAVITY,
    LEARNED_DRAG,
    RATE_TIME_CONSTANTS,
    THRUST_SCALE,
    THRUST_TIME_CONSTANT,
    UNEVEN_DRAG,
    VECTOR_SIZE,
)
from quad_mpc_ros.control.model.rollout import BODY_RATES

# At the start: horizontally, vertically, of the scale.
_ACCELERATION_SPREAD, _VERTICAL_SPREAD, _SCALE_SPREAD = 1.0, 0.5, 0.2

_DISTURBANCE, _UNEVEN_DRAG, _LEARNED_DRAG = (
    part.start for part in (DISTURBANCE, UNEVEN_DRAG, LEARNED_DRAG)
)

# From a command to what it does by default [s], and by how much closer at most vehicles are
# followed that answer sooner.
_USUAL_LAG, _CLOSEST = 0.13, 4.0


class Filters(NamedTuple):
    """The filters, with what they are by: the parts of one buffer, see :func:`filters_in`.

    ``estimate`` (15,) and ``covariance`` (9, 9) of :mod:`.velocity_filter`; vectors of
    :mod:`.velocity_noise`, :mod:`.rate_lags` and :mod:`.rate_offsets`; the configured parameters
    (29,); ``shape`` (3,), what of the mean drag each axis has more or less, as a share of it; and
    ``bounds`` (3,), of the throttle and of the disturbance along the ground.
    """

    estimate: Array
    covariance: Array
    noise: Array
    rate_lags: Array
    rate_offsets: Array
    nominal: Array
    shape: Array
    bounds: Array


_COVARIANCE = slice(ESTIMATE_SIZE, ESTIMATE_SIZE + SIZE**2)
_NOISE = slice(_COVARIANCE.stop, _COVARIANCE.stop + velocity_noise.SIZE)
_RATE_LAGS = slice(_NOISE.stop, _NOISE.stop + rate_lags.SIZE)
_RATE_OFFSETS = slice(_RATE_LAGS.stop, _RATE_LAGS.stop + rate_offsets.SIZE)
_NOMINAL = slice(_RATE_OFFSETS.stop, _RATE_OFFSETS.stop + VECTOR_SIZE)
_SHAPE = slice(_NOMINAL.stop, _NOMINAL.stop + 3)
_BOUNDS = slice(_SHAPE.stop, _SHAPE.stop + 3)
BUFFER_SIZE = _BOUNDS.stop


@compiled
def filters_in(buffer: Array) -> Filters:
    """Return the parts of a buffer, in which they are one after another."""
    return Filters(
        buffer[:ESTIMATE_SIZE],
        buffer[_COVARIANCE].reshape((SIZE, SIZE)),
        buffer[_NOISE],
        buffer[_RATE_LAGS],
        buffer[_RATE_OFFSETS],
        buffer[_NOMINAL],
        buffer[_SHAPE],
        buffer[_BOUNDS],
    )


class EkfMemory(NamedTuple):
    """What is believed at a moment: the estimate, its covariance, the rates' lags and offsets."""

    estimate: Array
    covariance: Array
    rate_lags: Array
    rate_offsets: Array


class DisturbanceEkf:
    """Follows a vehicle from odometry to odometry."""

    def __init__(
        self, nominal: Array, *, throttle: float, delay: float = 0.0, buffer: Array
    ) -> None:
        """``nominal`` are the configured parameters (29,), ``throttle`` is where it begins.

        ``delay`` [s] is that of the input. What is known is kept in ``buffer``, ``BUFFER_SIZE``
        zeros to begin with, see :func:`filters_in`; :func:`update` goes on with it.
        """
        self._filters = filters = filters_in(buffer)
        self._initial_throttle = throttle
        filters.nominal[:] = nominal
        filters.shape[:] = nominal[UNEVEN_DRAG] / (nominal[DRAG] or 1.0)
        filters.bounds[:] = -math.inf, math.inf, math.inf
        filters.estimate[K] = 1.0
        closer = _closer(nominal, delay)
        filters.noise[:] = velocity_noise.begun(velocity_noise.USUAL / closer)
        # Who tells that it answers soon is believed more: a lag that is learned although it is
        # none, of odometry that is late, is answered by commands that lead more, and swings.
        filters.rate_lags[:] = rate_lags.begun(nominal, slower=1.0 / closer)
        filters.rate_offsets[:] = rate_offsets.begun(nominal, share=min(closer - 1.0, 1.0))
        self.reset()
        self.start(np.zeros(3))

    def reset(self) -> None:
        """Believe the configured parameters again, and that loosely.

        But for the thrust: its scale becomes that which alone carries the vehicle as scale and
        disturbance did together, for it may have been flying by them.
        """
        estimate, P, noise, *_ = self._filters
        nominal = self._filters.nominal
        gravity = nominal[GRAVITY]
        scale = estimate[K] * gravity / (gravity - estimate[D + 2])
        velocity = estimate[V:D].copy()
        estimate[D:K] = 0.0
        estimate[K] = min(max(scale, SCALE_BOUNDS[0]), SCALE_BOUNDS[1])
        estimate[TAU] = nominal[THRUST_TIME_CONSTANT]
        estimate[MU] = nominal[DRAG]
        rate_lags.reset(self._filters.rate_lags)
        rate_offsets.reset(self._filters.rate_offsets)
        spreads = (_ACCELERATION_SPREAD, _ACCELERATION_SPREAD, _VERTICAL_SPREAD, _SCALE_SPREAD)
        lag_spread = LAG_SPREAD * nominal[THRUST_TIME_CONSTANT]
        P[:] = np.diag(np.square([0.0, 0.0, 0.0, *spreads, lag_spread, DRAG_SPREAD]))
        believe_velocity(estimate, P, velocity, velocity_noise.variance_in(noise))

    def reconfigure(
        self, *, throttle_min: float, throttle_max: float, disturbance_max: float
    ) -> None:
        """Take over changed bounds of the throttle, and of the disturbance along the ground."""
        self._filters.bounds[:] = throttle_min, throttle_max, disturbance_max

    def parameters(self) -> Array:
        """Return the parameters (29,) as believed by now."""
        believed = np.empty(VECTOR_SIZE)
        write_parameters(self._filters, believed)
        return believed

    def memory(self) -> EkfMemory:
        """Return what is believed, and how firmly."""
        filters = self._filters
        return EkfMemory(
            filters.estimate.copy(),
            filters.covariance.copy(),
            filters.rate_lags[rate_lags.BELIEVED].copy(),
            rate_offsets.believed_in(filters.rate_offsets).copy(),
        )

    def recall(self, memory: EkfMemory) -> None:
        """Believe again what was believed, of all but the present velocity and throttle."""
        filters = self._filters
        filters.estimate[LEARNABLE] = memory.estimate[LEARNABLE]
        filters.covariance[:] = memory.covariance
        filters.rate_lags[rate_lags.BELIEVED] = memory.rate_lags
        rate_offsets.believed_in(filters.rate_offsets)[:] = memory.rate_offsets
        self._believe(filters.estimate[V:D].copy())

    def turn(self, turn: Array) -> None:
        """Turn velocity and disturbance with the world's coordinates, by a rotation (3, 3)."""
        turns, (estimate, P, *_) = np.eye(SIZE), self._filters
        turns[V:D, V:D] = turns[D : D + 3, D : D + 3] = turn
        estimate[V:D] = turn @ estimate[V:D]
        estimate[D : D + 3] = turn @ estimate[D : D + 3]
        P[:] = turns @ P @ turns.T

    def start(self, v_WB_W: Array) -> None:
        """Begin with a velocity (3,); what was learned is kept."""
        self._filters.estimate[THROTTLE] = self._initial_throttle
        self._filters.estimate[THROTTLE_SLOPE] = 0.0
        velocity_noise.interrupt(self._filters.noise)
        self._believe(v_WB_W)

    def _believe(self, v_WB_W: Array) -> None:
        estimate, P, noise, *_ = self._filters
        believe_velocity(estimate, P, v_WB_W, velocity_noise.variance_in(noise))


@compiled
def update(
    filters: Filters,
    before: Array,
    after: Array,
    commands: Array,
    durations: Array,
    lesson: int,
    told_variance: float,
) -> int:
    """Go on from one odometry to the next, under the commands that acted between them.

    ``before`` and ``after`` are their states, rows (19,) of :mod:`~.model.rollout`,
    ``commands`` (n, 4) what acted, each for one of the ``durations`` (n,) [s]. ``lesson`` is what
    is allowed, ``LEARNED`` at most; the throttle is always followed. ``told_variance`` [m^2/s^2]
    is that of the second velocity, 0 where it is not told.

    Returns:
        What became of it, ``HELD``, ``PAUSED``, ``LEARNED`` or ``REFUSED``.
    """
    lowest, highest, farthest = kernels.vector(filters.bounds)
    outcome = velocity_filter.update(
        nominal=filters.nominal,
        estimate=filters.estimate,
        P=filters.covariance,
        noise=filters.noise,
        settings=(lowest, highest, farthest, told_variance),
        commands=commands,
        durations=durations,
        before=before,
        after=after,
        lesson=lesson,
    )
    learns, measured = outcome == LEARNED, after[BODY_RATES]
    follows = learns or outcome == PAUSED
    rate_lags.follow(
        lags=filters.rate_lags,
        commands=commands,
        durations=durations,
        measured=measured,
        learns=learns,
        follows=follows,
    )
    rate_offsets.follow(
        offsets=filters.rate_offsets,
        nominal=filters.nominal,
        lags=rate_lags.time_constants(filters.rate_lags),
        commands=commands,
        durations=durations,
        measured=measured,
        learns=learns,
        follows=follows,
    )
    return outcome


@compiled
def write_parameters(filters: Filters, parameters: Array) -> None:
    """Write the parameters (29,) as believed by now."""
    parameters[:] = filters.nominal
    kernels.store_vector(
        rate_lags.time_constants(filters.rate_lags), parameters[RATE_TIME_CONSTANTS]
    )
    rate_offsets.write(filters.rate_offsets, parameters)
    _write_learned(filters.estimate, filters.shape, parameters)


@compiled
def _write_learned(estimate: Array, shape: Array, parameters: Array) -> None:
    """Write what is believed of thrust, air and drag into the configured parameters (29,)."""
    parameters[THRUST_TIME_CONSTANT] = estimate[TAU]
    parameters[THRUST_SCALE] = estimate[K]
    learned = estimate[MU] - parameters[DRAG]
    parameters[DRAG] += learned
    for k in range(3):
        parameters[_DISTURBANCE + k] = estimate[D + k]
        uneven = learned * shape[k]
        parameters[_LEARNED_DRAG + k] = learned + uneven
        parameters[_UNEVEN_DRAG + k] += uneven


def _closer(nominal: Array, delay: float) -> float:
    """Return by how much closer than usual a vehicle is followed, 1 at least.

    What is learned is answered by commands, and a loop that is quicker than the actuators swings.
    Where they are as quick as the default's, or nothing is known of them, it is as usual.
    """
    roll, pitch, _yaw = nominal[RATE_TIME_CONSTANTS]
    lags = max(roll, pitch), nominal[THRUST_TIME_CONSTANT], delay
    if min(lags) <= 0.0:
        return 1.0
    return min(max((_USUAL_LAG / sum(lags)) ** 2, 1.0), _CLOSEST)
