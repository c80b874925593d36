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

**k and d_z look alike at hover**: only their sum k T/m + d_z = g is observable, and they differ as
the vehicle tilts or accelerates. Left to themselves they drift apart, for commands answer the
errors of the measured velocity: thrust that changes and moves nothing looks like little thrust. So
the sum is estimated, and its parts by what is likely: winds change, a lack of thrust lasts.
What of d_z lasts becomes a change of k, over some seconds, and their sum stays the same,

    dd_z/dt = -d_z / T + noise,   dk/dt = (d_z / T) / (T_s/m e3' z_B) + noise.

All else but v are random walks, and everything is clamped to bounds.

**Not every odometry updates all.** On the ground, and where commands do not act, the measured
velocity is taken and nothing learned. Where a command is saturated, or so little that the
ground might carry the vehicle, the velocity alone is corrected. It must not be taken as
measured then: which commands are little depends on the noise of the measurement before, and a
filter that began anew from just those would find too much thrust, 0.1 of the scale with 0.2 m/s of
noise. An odometry that jumps updates nothing either.

**Drag** is distinguished from wind by motion: it turns with the velocity, and is known before
a turn.
At rest nothing is learned of it. The reference's attitudes were made with another drag, so the
target tilts them by the difference (:mod:`.ocp.target`).

A time constant of zero is no lag and stays. The throttle, which nobody measures, is followed
through the lag. The noise of the velocity is estimated as well (:mod:`.velocity_noise`), time
constants and offsets of the rates have filters of their own (:mod:`.rate_lags`,
:mod:`.rate_offsets`). The delay of the input is not estimated: ``docs/tuning.md`` says why.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, Vector3
from quad_mpc_ros.control.estimation import (
    rate_lags,
    rate_offsets,
    velocity_filter,
    velocity_noise,
)
from quad_mpc_ros.control.estimation.command_history import Acting
from quad_mpc_ros.control.estimation.rate_lags import RateLags
from quad_mpc_ros.control.estimation.rate_offsets import RateOffsets
from quad_mpc_ros.control.estimation.velocity_filter import (
    DRAG_SPREAD,
    LAG_SPREAD,
    LEARNABLE,
    LEARNED,
    MU,
    PAUSED,
    SCALE_BOUNDS,
    SIZE,
    TAU,
    Bounds,
    D,
    K,
    V,
    VelocityEstimate,
    take_velocity,
)
from quad_mpc_ros.control.estimation.velocity_noise import VelocityNoise
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.parameters import ModelParameters
from quad_mpc_ros.control.model.rollout import StateRecord

# At the start: horizontally, vertically, of the scale.
_ACCELERATION_SPREAD, _VERTICAL_SPREAD, _SCALE_SPREAD = 1.0, 0.5, 0.2

# From a command to what it does by default [s], and by how much closer at most vehicles are
# followed that answer sooner.
_USUAL_LAG, _CLOSEST = 0.13, 4.0


class Filters(Record):
    """The filters, and what is configured of them."""

    velocity: VelocityEstimate
    noise: VelocityNoise
    rate_lags: RateLags
    rate_offsets: RateOffsets
    nominal: ModelParameters  # as configured
    scratch: ModelParameters  # nominal, but for what the last prediction used of the estimate
    drag_shape: Vector3  # what of the mean drag each axis has more or less, as a share of it
    bounds: Bounds


class EkfMemory(NamedTuple):
    """What is estimated at a moment: state, covariance, the rates' lags and offsets."""

    x: Array
    P: Array
    rate_lags: Any
    rate_offsets: Any


class DisturbanceEkf:
    """Follows a vehicle from odometry to odometry."""

    def __init__(
        self,
        nominal: ModelParameters,
        *,
        throttle: float,
        delay: float = 0.0,
        filters: Filters,
    ) -> None:
        """``nominal`` are the configured parameters, ``throttle`` is where it begins.

        ``delay`` [s] is that of the input. The estimate is kept in ``filters``, zeros to begin
        with; :func:`update` goes on with it.
        """
        self._filters = filters
        self._initial_throttle = throttle
        filters.nominal = filters.scratch = nominal
        filters.drag_shape[:] = nominal.uneven_drag / (nominal.drag or 1.0)
        bounds = filters.bounds
        bounds.throttle_min, bounds.throttle_max = -math.inf, math.inf
        bounds.disturbance_max = math.inf
        filters.velocity.x[K] = 1.0
        closer = _closer(nominal, delay)
        velocity_noise.start(filters.noise, velocity_noise.USUAL / closer)
        # Shorter lags are trusted more: a lag that is learned although it is none, of odometry
        # that is late, is answered by commands that lead more, and oscillates.
        rate_lags.start(filters.rate_lags, nominal, slower=1.0 / closer)
        rate_offsets.start(filters.rate_offsets, nominal, share=min(closer - 1.0, 1.0))
        self.reset()
        self.start(np.zeros(3))

    def reset(self) -> None:
        """Return to the configured parameters, with the covariance of the start.

        But for the thrust: its scale becomes that which alone carries the vehicle as scale and
        disturbance did together, for it may have been flying by them.
        """
        filters = self._filters
        nominal, x, P = filters.nominal, filters.velocity.x, filters.velocity.P
        scale = x[K] * nominal.gravity / (nominal.gravity - x[D + 2])
        velocity = x[V:D].copy()
        x[D:K] = 0.0
        x[K] = min(max(scale, SCALE_BOUNDS[0]), SCALE_BOUNDS[1])
        x[TAU] = nominal.thrust_time_constant
        x[MU] = nominal.drag
        rate_lags.reset(filters.rate_lags)
        rate_offsets.reset(filters.rate_offsets)
        spreads = (_ACCELERATION_SPREAD, _ACCELERATION_SPREAD, _VERTICAL_SPREAD, _SCALE_SPREAD)
        lag_spread = LAG_SPREAD * nominal.thrust_time_constant
        P[:] = np.diag(np.square([0.0, 0.0, 0.0, *spreads, lag_spread, DRAG_SPREAD]))
        self._take_velocity(velocity)

    def reconfigure(
        self, *, throttle_min: float, throttle_max: float, disturbance_max: float
    ) -> None:
        """Take over changed bounds of the throttle, and of the disturbance along the ground."""
        bounds = self._filters.bounds
        bounds.throttle_min, bounds.throttle_max = throttle_min, throttle_max
        bounds.disturbance_max = disturbance_max

    def parameters(self) -> ModelParameters:
        """Return the parameters as estimated by now."""
        estimated = ModelParameters.zeros()
        estimated[()] = self._filters.nominal
        write_estimated(self._filters, estimated[()])
        return estimated[()]

    def memory(self) -> EkfMemory:
        """Return the estimate and its covariance."""
        filters = self._filters
        return EkfMemory(
            filters.velocity.x.copy(),
            filters.velocity.P.copy(),
            filters.rate_lags.estimate.copy(),
            filters.rate_offsets.estimate.copy(),
        )

    def recall(self, memory: EkfMemory) -> None:
        """Return to an earlier estimate of all but the present velocity and throttle."""
        filters = self._filters
        filters.velocity.x[LEARNABLE] = memory.x[LEARNABLE]
        filters.velocity.P[:] = memory.P
        filters.rate_lags.estimate = memory.rate_lags
        filters.rate_offsets.estimate = memory.rate_offsets
        self._take_velocity(filters.velocity.x[V:D].copy())

    def turn(self, turn: Array) -> None:
        """Turn velocity and disturbance with the world's coordinates, by a rotation (3, 3)."""
        turns, x, P = np.eye(SIZE), self._filters.velocity.x, self._filters.velocity.P
        turns[V:D, V:D] = turns[D:K, D:K] = turn
        x[V:D] = turn @ x[V:D]
        x[D:K] = turn @ x[D:K]
        P[:] = turns @ P @ turns.T

    def start(self, v_WB_W: Array) -> None:
        """Begin with a velocity (3,); what was learned is kept."""
        velocity = self._filters.velocity
        velocity.throttle, velocity.throttle_slope = self._initial_throttle, 0.0
        velocity_noise.interrupt(self._filters.noise)
        self._take_velocity(v_WB_W)

    def _take_velocity(self, v_WB_W: Array) -> None:
        variance = velocity_noise.variance_in(self._filters.noise)
        take_velocity(self._filters.velocity, v_WB_W, variance)


@compiled
def update(
    filters: Filters,
    before: StateRecord,
    after: StateRecord,
    acting: Acting,
    mode: int,
    given_variance: float,
) -> int:
    """Go on from one odometry to the next, under the commands that acted between them.

    ``before`` and ``after`` are their states, ``mode`` is what may be estimated, ``LEARNED`` at
    most; the throttle is always followed. ``given_variance`` [m^2/s^2] is that of the second
    velocity, 0 where it is not known.

    Returns:
        What became of it, ``HELD``, ``PAUSED``, ``LEARNED`` or ``REFUSED``.
    """
    outcome = velocity_filter.update(
        modelled=filters.nominal,
        scratch=filters.scratch,
        estimate=filters.velocity,
        noise=filters.noise,
        bounds=filters.bounds,
        acting=acting,
        before=before,
        after=after,
        mode=mode,
        given_variance=given_variance,
    )
    learns, measured = outcome == LEARNED, after.w_WB_B
    follows = learns or outcome == PAUSED
    rate_lags.follow(
        lags=filters.rate_lags,
        commands=acting.commands,
        durations=acting.durations,
        measured=measured,
        learns=learns,
        follows=follows,
    )
    rate_offsets.follow(
        offsets=filters.rate_offsets,
        nominal=filters.nominal,
        lags=rate_lags.time_constants(filters.rate_lags),
        commands=acting.commands,
        durations=acting.durations,
        measured=measured,
        learns=learns,
        follows=follows,
    )
    return outcome


@compiled
def write_estimated(filters: Filters, parameters: ModelParameters) -> None:
    """Write what is estimated by now into the configured parameters."""
    kernels.store_vector(
        rate_lags.time_constants(filters.rate_lags), parameters.rate_time_constants
    )
    rate_offsets.write(filters.rate_offsets, parameters)
    x, shape = filters.velocity.x, filters.drag_shape
    parameters.thrust_time_constant = x[TAU]
    parameters.thrust_scale = x[K]
    learned = x[MU] - parameters.drag
    parameters.drag += learned
    for k in range(3):
        parameters.a_W[k] = x[D + k]
        uneven = learned * shape[k]
        parameters.learned_drag[k] = learned + uneven
        parameters.uneven_drag[k] += uneven


def _closer(nominal: ModelParameters, delay: float) -> float:
    """Return by how much closer than usual a vehicle is followed, 1 at least.

    What is learned is answered by commands, and a loop that is quicker than the actuators
    oscillates. Where they are as quick as the default's, or nothing is known of them, it is as
    usual.
    """
    roll, pitch, _yaw = nominal.rate_time_constants
    lags = max(roll, pitch), nominal.thrust_time_constant, delay
    if min(lags) <= 0.0:
        return 1.0
    return min(max((_USUAL_LAG / sum(lags)) ** 2, 1.0), _CLOSEST)
