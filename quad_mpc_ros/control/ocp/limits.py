# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Soft limits on the plan: bounds, rows of the QP, and the penalty for violations.

    tilt_i <= bound,   |v_i| <= bound,   n_ij' p_i <= b_ij,  j = 1..K             i = 1..N

Each kind is relaxed by one slack per stage, at a cost c s + 1/2 d s^2; the half-spaces n, b of a
corridor share one slack. A limit bounds deviations from the reference: where the reference exceeds
a limit, the bound is the reference's value plus a margin.

Rows are linearised about a rollout; rows of half-spaces are exact. The tilt is a vector in the
plane of the body's x and y axes, as long as the angle between thrust axis and up. A rotation R
exp([φ]) lengthens this vector by

    dθ = (R_32 φ_x - R_31 φ_y) / sin θ

and a rotation about the perpendicular direction keeps its length: four rows form a square around
the disc, and one side touches the disc at the rollout. At level attitude this direction is
undefined; the descent direction of the cost is used instead.

The weight c of an exact penalty has to exceed the multiplier of the hard constraint, which is
about the decrease of the tracking cost if a limit were relaxed. So the weights are computed at the
rollout, for each problem, from the gradients p_i of the remaining cost, p_i = g_i + A_i' p_{i+1}.
Constant weights would have to cover the largest jump, and a solver's tolerance grows with the
largest number in the problem. A vehicle that brakes or swerves is constrained by half-spaces of
only one or two stages, whose multipliers add up the gains of all others; hence their larger
factor, which tests show to be exact.

Near a limit the best step is all or nothing, which a first-order solver finds slowly. There,
changes of the plan have a cost (:func:`regularise_limits`), in proportion to the slopes. The
position error of the target is saturated (:func:`saturate_position_error`); otherwise the vehicle
would lose height to gain speed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import RecordArray
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.control.model.rollout import StateRecord, body_in
from quad_mpc_ros.control.model.state import THETA, U_RATE, U_THROTTLE, P, V
from quad_mpc_ros.control.model.target import TargetStage
from quad_mpc_ros.control.ocp.horizon_qp import FREE, HorizonStages, LimitPattern
from quad_mpc_ros.control.ocp.settings import ProblemSettings

# The kinds, in the order of their rows. There are as many rows of half-spaces as are configured.
_TILT, _SPEED, _HALF_SPACES = range(3)
_ROWS = (4, 1)
# By kind: a typical violation; the natural size of the slack; the quadratic weight as a share of
# the linear one; the distance at which a plan starts to count as near a limit.
_TYPICAL = np.array([0.5, 3.0, 0.3])
_SLACK_SIZES = np.array([0.5, 1.0, 0.3])
_QUADRATIC = np.array([0.5, 0.5, 1.0])
_NEAR = np.array([0.2, 0.5, 0.1])

# Margins beyond the reference's own values: tilt [rad], speed [m/s].
TILT_MARGIN, SPEED_MARGIN = 0.3, 1.0
# Weights: share of a slope, which includes all later stages; least weight of a typical
# violation, and least share of the steepest slope.
_SLOPE_SHARE, _LEAST_WEIGHT, _LEAST_SHARE = 0.8, 0.4, 0.2
_HALF_SPACE_SLOPE, _LEAST_HALF_SPACE_WEIGHT = 2.0, 4.0
_SWERVE_TIME = 0.3  # s, in which a change of the velocity becomes one of the position
# Costs of changes of the plan, as shares of that slope: throttle, rates, velocity, attitude.
_DAMPING_THROTTLE = 0.02 / 0.3**2
_DAMPING_RATES = 0.2 / 5.0**2
_DAMPING_VELOCITY = 0.03 / 3.0**2
_DAMPING_ATTITUDE = 0.03 / 0.5**2
# Below this tilt [rad] or speed [m/s] the direction does not predict the next stages.
_MIN_TILT, _MIN_SPEED = 0.05, 0.3


class Limits(NamedTuple):
    """The soft limits of a horizon of N stages.

    ``rows`` and ``slacks`` (3,) are the first row and the slack of each kind in a stage, or -1.
    ``bounds`` (N, 2) are the bounds of tilt [rad] and speed [m/s] along the target, FREE for none,
    (0, 2) without any limit. ``weights`` (3,) are the linear penalty weights of the current
    iterate. The corridor's half-spaces are ``normals`` (N, K, 3) and ``offsets`` (N, K), FREE for
    none.
    """

    rows: NDArray[np.intp]
    slacks: NDArray[np.intp]
    bounds: Array
    weights: Array
    normals: Array
    offsets: Array

    @staticmethod
    def zeros(settings: ProblemSettings, steps: int, *, half_spaces: int = 0) -> Limits:
        """Return the configured limits and the number of half-spaces for N stages."""
        counts = np.array([*_ROWS, half_spaces])
        has = np.array([settings.tilt_max > 0.0, settings.speed_max > 0.0, half_spaces > 0])
        return Limits(
            rows=np.where(has, np.cumsum(counts * has) - counts, -1),
            slacks=np.where(has, np.cumsum(has) - 1, -1),
            bounds=np.zeros((steps if has.any() else 0, 2)),
            weights=np.zeros(len(counts)),
            normals=np.zeros((steps, half_spaces, 3)),
            offsets=np.full((steps, half_spaces), FREE),
        )

    def pattern(self, nx: int) -> LimitPattern:
        """Return the pattern of the rows, with ``nx`` states."""
        counts = np.array([*_ROWS, self.offsets.shape[1]])
        masks = [np.zeros((count, nx), dtype=bool) for count in counts]
        masks[_TILT][:, THETA : THETA + 2] = True
        masks[_SPEED][:, V:THETA] = True
        masks[_HALF_SPACES][:, P:V] = True
        kinds = np.flatnonzero(self.rows >= 0)
        return LimitPattern(
            mask=np.vstack([masks[0][:0], *(masks[kind] for kind in kinds)]),
            slack_of=np.repeat(np.arange(len(kinds)), counts[kinds]),
            slack_size=_SLACK_SIZES[kinds],
        )

    def set_corridor(self, corridor: Corridor, *, stamp_ns: int, step: float) -> None:
        """Set the half-spaces at the ends of stages of ``step`` seconds, starting at a stamp.

        Rows beyond K are dropped; after the corridor's last stage, that stage is repeated.
        """
        rows = min(self.offsets.shape[1], corridor.offsets.shape[1])
        since = (stamp_ns - corridor.stamp_ns) * 1e-9
        ends = (since + step * np.arange(1, len(self.offsets) + 1)) / corridor.step
        stages = np.clip(np.rint(ends).astype(np.intp) - 1, 0, len(corridor.offsets) - 1)
        self.offsets[:], self.normals[:] = FREE, 0.0
        self.normals[:, :rows] = corridor.normals[stages, :rows]
        self.offsets[:, :rows] = np.minimum(corridor.offsets[stages, :rows], FREE)


@compiled
def compute_bounds(
    settings: ProblemSettings,
    target: RecordArray[TargetStage],
    any_tilt: bool,
    bounds: Array,
) -> None:
    """Write the bounds (N, 2) along a target; with ``any_tilt`` the tilt is not limited."""
    for i in range(len(bounds)):
        stage = target[i]
        own = math.acos(kernels.clamp(stage.R_WB[2, 2], -1.0, 1.0))
        tilt = max(settings.tilt_max, own + TILT_MARGIN)
        has_tilt = settings.tilt_max > 0.0 and tilt < math.pi and not any_tilt
        bounds[i, _TILT] = tilt if has_tilt else FREE
        speed = max(settings.speed_max, kernels.length(stage.v_WB_W) + SPEED_MARGIN)
        bounds[i, _SPEED] = speed if settings.speed_max > 0.0 else FREE


@compiled
def flips(
    settings: ProblemSettings, R_start: kernels.Matrix, target: RecordArray[TargetStage]
) -> bool:
    """Whether the thrust axis of a target anywhere turns faster than the bound on body rates.

    This happens near free fall, where the direction of a small thrust is insignificant.
    ``R_start`` is the attitude at the start of the first stage.
    """
    u_max = settings.u_max
    before = kernels.column(R_start, 2)
    slowest = math.cos(min(max(u_max[1], u_max[2]) * settings.step, math.pi))
    for i in range(len(target)):
        after = kernels.column(kernels.matrix(target[i].R_WB), 2)
        if kernels.dot(before, after) < slowest:
            return True
        before = after
    return False


@compiled
def saturate_position_error(
    settings: ProblemSettings, start: StateRecord, target: RecordArray[TargetStage]
) -> None:
    """Move a target so that its first position is at most ``max_position_error`` away.

    The distance is from the state ``start``, separately horizontal and vertical, so that a
    horizontal error does not outweigh height.
    """
    first, distance = target[0], settings.max_position_error
    off = kernels.minus(kernels.vector(start.p_WB), kernels.vector(first.p_WB))
    moved = kernels.scaled(settings.step, kernels.vector(first.v_WB_W))
    x, y, z = kernels.plus(off, moved)
    across = 1.0 - distance / max(math.hypot(x, y), distance)
    height = 1.0 - distance / max(abs(z), distance)
    for i in range(len(target)):
        p_WB = target[i].p_WB
        p_WB[0] += across * x
        p_WB[1] += across * y
        p_WB[2] += height * z


@compiled
def regularise_limits(
    R: Array, weights: Array, activity: float, full_damping_slope: float, stages: HorizonStages
) -> float:
    """Add a cost to changes of the plan, so that a step is not all or nothing; return its scale.

    ``R`` (4,) are the weights on the plan's inputs. The scale is the steepest slope of the cost,
    times the constraint ``activity`` or the slope over ``full_damping_slope``, whichever is
    larger. The iterations still converge to the plan without this cost.
    """
    slope = _steepest_slope(weights)
    scale = max(activity, min(1.0, slope / full_damping_slope)) * slope
    H = stages.H
    for i in range(len(H)):
        stages.R[i, U_THROTTLE] = R[U_THROTTLE] + _DAMPING_THROTTLE * scale
        for k in range(3):
            stages.R[i, U_RATE + k] = R[U_RATE + k] + _DAMPING_RATES * scale
            H[i, V + k, V + k] += _DAMPING_VELOCITY * scale
            H[i, THETA + k, THETA + k] += _DAMPING_ATTITUDE * scale
    return scale


@compiled
def _steepest_slope(weights: Array) -> float:
    """Return the steepest slope of the cost, per typical change of attitude or velocity."""
    steepest = max(weights[_TILT] * _TYPICAL[_TILT], weights[_SPEED] * _TYPICAL[_SPEED])
    return float(steepest / _SLOPE_SHARE)


@compiled
def limits_cost(limits: Limits, states: RecordArray[StateRecord]) -> tuple[float, float]:
    """Return the penalty for the limits that the states 0 to N of a plan exceed, and the activity.

    The penalty is in the units of the tracking cost, which is twice the QP's cost. The activity is
    1 at a limit or a plane, 0 well inside all limits.
    """
    weights, normals, offsets = limits.weights, limits.normals, limits.offsets
    cost, activity, weight = 0.0, 0.0, weights[_HALF_SPACES]
    for i in range(len(offsets) if offsets.shape[1] > 0 else 0):
        excess = _half_space_excess(kernels.vector(states[i + 1].p_WB), normals[i], offsets[i])
        cost += _penalty_of(_HALF_SPACES, weight, excess)
        activity = max(activity, 1.0 + excess / _NEAR[_HALF_SPACES])
    for i in range(len(limits.bounds)):
        each = _excess(states[i + 1], limits.bounds[i])
        for kind in range(len(each)):
            cost += _penalty_of(kind, weights[kind], each[kind])
            activity = max(activity, 1.0 + each[kind] / _NEAR[kind])
    return cost, min(activity, 1.0)


@compiled
def _penalty_of(kind: int, weight: float, excess: float) -> float:
    if excess <= 0.0:
        return 0.0
    curvature = 0.5 * _QUADRATIC[kind] / _TYPICAL[kind] * excess
    return float(2.0 * weight * excess * (1.0 + curvature))


@compiled
def _excess(state: StateRecord, bounds: Array) -> tuple[float, float]:
    """Return the excess of tilt and speed over their bounds (2,), negative inside."""
    body = body_in(state)
    R_31, R_32, R_33 = kernels.row(body.R, 2)
    tilt = math.atan2(math.hypot(R_31, R_32), R_33)
    return tilt - bounds[_TILT], kernels.norm(body.v) - bounds[_SPEED]


@compiled
def _half_space_excess(p: kernels.Vector, normals: Array, offsets: Array) -> float:
    """Return the distance of a position beyond the farthest plane, negative inside."""
    most = -FREE
    for j in range(len(offsets)):
        if offsets[j] < FREE:
            most = max(most, kernels.dot(kernels.vector(normals[j]), p) - offsets[j])
    return most


@compiled
def write_limits(
    limits: Limits, states: RecordArray[StateRecord], stages: HorizonStages
) -> tuple[float, float]:
    """Write soft rows and weights about the states 0 to N of a plan; return :func:`limits_cost`.

    The stages already contain the rest of the QP about this plan.
    """
    slopes, weights = np.empty_like(stages.g), limits.weights
    _write_weights(stages, weights, slopes)
    for i in range(len(slopes)):
        rows, offsets = stages.normals[i], stages.offsets[i]
        body, bounds = body_in(states[i + 1]), limits.bounds[i]
        row = limits.rows[_TILT]
        if row >= 0:
            _write_tilt(body.R, slopes[i], bounds[_TILT], rows[row:], offsets[row:])
        row = limits.rows[_SPEED]
        if row >= 0:
            offsets[row] = _write_speed(body.v, slopes[i], bounds[_SPEED], rows[row])
        for j in range(limits.offsets.shape[1]):
            row, n_ij = limits.rows[_HALF_SPACES] + j, kernels.vector(limits.normals[i, j])
            kernels.store_vector(n_ij, rows[row, P:])
            b_ij = limits.offsets[i, j]
            offsets[row] = FREE if b_ij >= FREE else b_ij - kernels.dot(n_ij, body.p)
        for kind in range(len(weights)):
            slack = limits.slacks[kind]
            if slack >= 0:
                stages.linear[i, slack] = weights[kind]
                stages.quadratic[i, slack] = weights[kind] * _QUADRATIC[kind] / _TYPICAL[kind]
    return limits_cost(limits, states)


@compiled
def _write_tilt(
    R: kernels.Matrix, slope: Array, bound: float, rows: Array, offsets: Array
) -> None:
    """Write the four sides of the square around the disc of tilts within the bound."""
    R_31, R_32, R_33 = kernels.row(R, 2)
    length = math.hypot(R_31, R_32)
    angle = math.atan2(length, R_33)
    if length > _MIN_TILT:
        x, y, along = R_32 / length, -R_31 / length, angle
        across = 0.0
    else:
        x, y = _direction(-slope[THETA], -slope[THETA + 1])
        # A small tilt is the vector (R_32, -R_31); near pi all directions lead down.
        along, across = R_32 * x - R_31 * y, -R_32 * y - R_31 * x
        if R_33 < 0.0:
            x, y, along, across = -x, -y, angle, 0.0
    sides = (x, y, along), (-x, -y, -along), (-y, x, across), (y, -x, -across)
    for side, (of_x, of_y, own) in enumerate(sides):
        rows[side, THETA], rows[side, THETA + 1] = of_x, of_y
        offsets[side] = bound - own


@compiled
def _direction(x: float, y: float) -> tuple[float, float]:
    """Return the direction of a vector in a plane, arbitrary for a zero vector."""
    length = math.hypot(x, y)
    if length < 1e-12:
        return 1.0, 0.0
    return x / length, y / length


@compiled
def _write_speed(v: kernels.Vector, slope: Array, bound: float, row: Array) -> float:
    """Write the plane that touches the ball of bounded velocities in the velocity's direction.

    Returns the offset of the plane.
    """
    n = v if kernels.norm(v) >= _MIN_SPEED else kernels.scaled(-1.0, kernels.vector(slope[V:]))
    length = kernels.norm(n)
    n = kernels.scaled(1.0 / length, n) if length > 1e-12 else (1.0, 0.0, 0.0)
    kernels.store_vector(n, row[V:])
    return bound - kernels.dot(n, v)


@compiled
def _write_weights(stages: HorizonStages, weights: Array, slopes: Array) -> None:
    """Write the gradients (N, nx) of the cost in states 1 to N, and the resulting weights (3,)."""
    n, nx = slopes.shape
    for kind in range(len(weights)):
        weights[kind] = _LEAST_WEIGHT / _TYPICAL[kind]
    weights[_HALF_SPACES] = _LEAST_HALF_SPACE_WEIGHT
    for i in range(n - 1, -1, -1):
        for k in range(nx):
            slope = stages.g[i, k]
            if i < n - 1:
                for j in range(nx):
                    slope += stages.A[i + 1, j, k] * slopes[i + 1, j]
            slopes[i, k] = slope
        p = slopes[i]
        _raise(weights, _TILT, _SLOPE_SHARE * math.hypot(p[THETA], p[THETA + 1]))
        by_p, by_v = kernels.length(p[P:]), kernels.length(p[V:])
        _raise(weights, _SPEED, _SLOPE_SHARE * by_v)
        _raise(weights, _HALF_SPACES, _HALF_SPACE_SLOPE * by_p)
        _raise(weights, _HALF_SPACES, _HALF_SPACE_SLOPE * by_v / _SWERVE_TIME)
    least = _LEAST_SHARE * _steepest_slope(weights)
    for kind in range(_HALF_SPACES):
        _raise(weights, kind, least / _TYPICAL[kind])


@compiled
def _raise(weights: Array, kind: int, least: float) -> None:
    weights[kind] = max(weights[kind], least)
