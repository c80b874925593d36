"""Soft limits on the plan: their bounds, their rows of the QP, and the penalty for breaking them.

    tilt_i <= bound,   |v_i| <= bound,   n_ij' p_i <= b_ij,  j = 1..K             i = 1..N
    throttle_i and the rates' change from u_{i-1} to u_i between bounds           i = 0..N-1

Each kind is eased by one slack a stage, at a cost c s + 1/2 d s^2; the half-spaces n, b of a
corridor share one slack. A limit bounds what the controller adds: where the reference exceeds a
limit, the bound is the reference's own value and a margin. u_{-1} is the command sent last.

Rows are linear in what changes about a rollout; those of half-spaces are exact. The tilt is a
vector in the plane of the body's x and y axes, as long as the angle between thrust axis and up. A
turn R exp([φ]) lengthens it by

    dθ = (R_32 φ_x - R_31 φ_y) / sin θ

and a turn about the perpendicular direction leaves its length: four rows make a square about the
disc, one side of which touches it where the rollout is. Level there is no such direction, and that
in which the cost falls stands in for it.

The weight c of an exact penalty has to exceed the multiplier of the hard constraint, which is
about what the tracking cost would gain by easing a limit. So the weights are computed at the
rollout, for each problem, from the slopes p_i of the cost of all that follows, p_i = g_i + A_i'
p_{i+1}. Constant weights would have to suit the largest jump, and a solver's tolerance grows with
the largest number in its problem. A vehicle that brakes or swerves is held by one or two of the
half-spaces' stages alone, and these pay for what the others gain; hence their larger factor,
which tests find to be exact.

Near a limit the best step is all or nothing, and a first-order solver takes long to find it. There
changes of the plan have a cost (:func:`regularise_limits`), in proportion to the slopes. The
position error of the target is saturated (:func:`saturate_position_error`), else height would be
given away for speed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, RecordArray, Vector3
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.corridor import Corridor
from quad_mpc_ros.control.model.prediction import Prediction
from quad_mpc_ros.control.model.rollout import SUBSTEPS, StateRecord, body_in
from quad_mpc_ros.control.model.state import INPUT_SIZE, THETA, U_RATE, U_THROTTLE, P, V
from quad_mpc_ros.control.model.target import TargetStage
from quad_mpc_ros.control.ocp.horizon_qp import FREE, HorizonStages, LimitPattern
from quad_mpc_ros.control.ocp.plan import PlannedTrajectory
from quad_mpc_ros.control.ocp.settings import ProblemSettings

# The kinds, in the order of their rows. There are as many rows of half-spaces as are configured.
_TILT, _SPEED, _THROTTLE, _SLEW, _HALF_SPACES = range(5)
_ROWS = (4, 1, 2, 6)
# By kind: a typical violation; the natural size of the slack; the quadratic weight as a share of
# the linear one; the distance at which a plan starts to count as near a limit.
_TYPICAL = np.array([0.5, 3.0, 0.3, 2.5, 0.3])
_SLACK_SIZES = np.array([0.5, 1.0, 0.3, 2.5, 0.3])
_QUADRATIC = np.array([0.5, 0.5, 0.5, 0.5, 1.0])
_NEAR = np.array([0.2, 0.5, 0.05, 0.5, 0.1])


class StageBounds(Record):
    """Bounds of a stage; ``FREE`` where nothing is limited."""

    tilt: float  # rad
    speed: float  # m/s
    throttle_min: float
    throttle_max: float
    # Change of the rates since the stage before [rad/s]; in the first the rates themselves.
    rate_change_min: Vector3
    rate_change_max: Vector3


# Margins beyond the reference's own values: tilt [rad], speed [m/s], throttle.
TILT_MARGIN, SPEED_MARGIN, _THROTTLE_MARGIN = 0.3, 1.0, 0.1
# Weights: this share of a slope, which is that of all stages that follow together; of a typical
# violation at least this, and at least this share of the steepest slope.
_SLOPE_SHARE, _LEAST_WEIGHT, _LEAST_SHARE = 0.8, 0.4, 0.2
_HALF_SPACE_SLOPE, _LEAST_HALF_SPACE_WEIGHT = 2.0, 4.0
_SWERVE_TIME = 0.3  # s, in which a change of the velocity becomes one of the position
# Costs of changes of the plan, as shares of that slope: throttle, rates, velocity, attitude.
_DAMPING_THROTTLE = 0.02 / 0.3**2
_DAMPING_RATES = 0.2 / 5.0**2
_DAMPING_VELOCITY = 0.03 / 3.0**2
_DAMPING_ATTITUDE = 0.03 / 0.5**2
# Below this tilt [rad] or speed [m/s] its direction says little of where it will be.
_MIN_TILT, _MIN_SPEED = 0.05, 0.3


class Limits(NamedTuple):
    """The soft limits of a horizon of N stages.

    ``rows`` and ``slacks`` (5,) are the first row and the slack of each kind in a stage, -1 for
    none, ``bounds`` (N,) the bounds along the target, (0,) without any limit, ``weights`` (5,) the
    linear penalty weights of the present iterate. The corridor's half-spaces are ``normals``
    (N, K, 3) and ``offsets`` (N, K), FREE for none.
    """

    rows: NDArray[np.intp]
    slacks: NDArray[np.intp]
    bounds: RecordArray[StageBounds]
    weights: Array
    normals: Array
    offsets: Array

    @staticmethod
    def zeros(settings: ProblemSettings, steps: int, *, half_spaces: int = 0) -> Limits:
        """Return the configured limits and so many half-spaces for N stages."""
        counts = np.array([*_ROWS, half_spaces])
        has = np.array([*(settings.limits > 0.0), half_spaces > 0])
        return Limits(
            rows=np.where(has, np.cumsum(counts * has) - counts, -1),
            slacks=np.where(has, np.cumsum(has) - 1, -1),
            bounds=StageBounds.zeros(steps if has.any() else 0),
            weights=np.zeros(len(counts)),
            normals=np.zeros((steps, half_spaces, 3)),
            offsets=np.full((steps, half_spaces), FREE),
        )

    def pattern(self, nx: int, nu: int) -> LimitPattern:
        """Return which entries the rows have, with ``nx`` states and ``nu`` inputs."""
        counts, x = np.array([*_ROWS, self.offsets.shape[1]]), 2 * nu
        masks = [np.zeros((count, 2 * nu + nx), dtype=bool) for count in counts]
        masks[_TILT][:, x + THETA : x + THETA + 2] = True
        masks[_SPEED][:, x + V : x + THETA] = True
        masks[_THROTTLE][:, nu + U_THROTTLE] = True
        for k in range(3):
            masks[_SLEW][2 * k : 2 * k + 2, [U_RATE + k, nu + U_RATE + k]] = True
        masks[_HALF_SPACES][:, x + P : x + V] = True
        kinds = np.flatnonzero(self.rows >= 0)
        return LimitPattern(
            mask=np.vstack([masks[0][:0], *(masks[kind] for kind in kinds)]),
            slack_of=np.repeat(np.arange(len(kinds)), counts[kinds]),
            slack_size=_SLACK_SIZES[kinds],
        )

    def set_corridor(self, corridor: Corridor, *, stamp_ns: int, step: float) -> None:
        """Set the half-spaces to those at the ends of stages of ``step`` seconds from a stamp on.

        Rows beyond K are dropped; after the corridor's last stage that one holds.
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
    prediction: Prediction,
    target: RecordArray[TargetStage],
    any_tilt: bool,
    bounds: RecordArray[StageBounds],
) -> None:
    """Write the bounds (N,) along a target, with ``any_tilt`` none of the tilt.

    Bounds of kinds that are not limited are ``FREE`` or more.
    """
    limits, sent, since = settings.limits, prediction.sent, prediction.since_sent
    for i in range(len(bounds)):
        stage, bound = target[i], bounds[i]
        own = math.acos(kernels.clamp(stage.R_WB[2, 2], -1.0, 1.0))
        tilt = max(limits[_TILT], own + TILT_MARGIN)
        has_tilt = limits[_TILT] > 0.0 and tilt < math.pi and not any_tilt
        bound.tilt = tilt if has_tilt else FREE
        v = kernels.vector(stage.v_WB_W)
        speed = max(limits[_SPEED], math.sqrt(kernels.dot(v, v)) + SPEED_MARGIN)
        bound.speed = speed if limits[_SPEED] > 0.0 else FREE
        margin, throttle = limits[_THROTTLE], stage.mean_input[U_THROTTLE]
        has_margin = margin > 0.0
        least = min(settings.u_min[U_THROTTLE] + margin, throttle - _THROTTLE_MARGIN)
        most = max(settings.u_max[U_THROTTLE] - margin, throttle + _THROTTLE_MARGIN)
        bound.throttle_min = least if has_margin else -FREE
        bound.throttle_max = most if has_margin else FREE
        duration = since if i == 0 else settings.step
        # Before the first command the time since it is infinite.
        has_slew = limits[_SLEW] > 0.0 and limits[_SLEW] * duration < FREE
        if not has_slew:
            bound.rate_change_min[:], bound.rate_change_max[:] = -FREE, FREE
            continue
        change = limits[_SLEW] * duration
        for k in range(3):
            rate = U_RATE + k
            if i == 0:  # as it changes within the stage
                first, last = stage.inputs[0, rate], stage.inputs[SUBSTEPS - 1, rate]
                before, by_itself = sent[rate], (last - first) / (SUBSTEPS - 1)
                by_itself *= SUBSTEPS / settings.step * since
            else:
                before = 0.0
                by_itself = stage.mean_input[rate] - target[i - 1].mean_input[rate]
            bound.rate_change_min[k] = before + (min(by_itself, 0.0) - change)
            bound.rate_change_max[k] = before + (max(by_itself, 0.0) + change)


@compiled
def flips(
    settings: ProblemSettings, R_start: kernels.Matrix, target: RecordArray[TargetStage]
) -> bool:
    """Whether the thrust axis of a target turns faster somewhere than body rates are bounded to.

    That happens near free fall, where the direction of little thrust means little. ``R_start`` is
    the attitude at the start of the first stage.
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

    The distance is from the state ``start``, horizontal and vertical each, so that a horizontal
    error does not outweigh height.
    """
    first, distance = target[0], settings.max_position_error
    x, y, z = (
        start.p_WB[0] - first.p_WB[0] + settings.step * first.v_WB_W[0],
        start.p_WB[1] - first.p_WB[1] + settings.step * first.v_WB_W[1],
        start.p_WB[2] - first.p_WB[2] + settings.step * first.v_WB_W[2],
    )
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

    ``R`` (4,) are the weights on its inputs. The scale is the steepest slope of the cost, times
    the constraint ``activity`` or the slope over ``full_damping_slope``, whichever is larger. The
    iterations converge to the same plan.
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
def limits_cost(
    limits: Limits, target: RecordArray[TargetStage], plan: PlannedTrajectory
) -> float:
    """Return the penalty for the limits that a plan exceeds.

    It is in the units of the tracking cost, which is twice that of the QP.
    """
    penalty, _activity = _penalty_and_activity(limits, plan.states, _planned_inputs(target, plan))
    return penalty


@compiled
def _penalty_and_activity(
    limits: Limits, states: RecordArray[StateRecord], inputs: Array
) -> tuple[float, float]:
    """Return the penalty, and the activity: 1 at a limit or a plane, 0 well inside of all."""
    bounds, weights, normals, offsets = (
        limits.bounds,
        limits.weights,
        limits.normals,
        limits.offsets,
    )
    cost, activity, weight = 0.0, 0.0, weights[_HALF_SPACES]
    for i in range(len(offsets) if offsets.shape[1] > 0 else 0):
        excess = _half_space_excess(kernels.vector(states[i + 1].p_WB), normals[i], offsets[i])
        cost += _penalty_of(_HALF_SPACES, weight, excess)
        activity = max(activity, 1.0 + excess / _NEAR[_HALF_SPACES])
    for i in range(len(bounds)):
        each = _excess(i, states, inputs, bounds)
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
def _excess(
    i: int, states: RecordArray[StateRecord], inputs: Array, bounds: RecordArray[StageBounds]
) -> tuple[float, float, float, float]:
    """Return by how much a stage exceeds each bound, negative inside."""
    body, bound = body_in(states[i + 1]), bounds[i]
    R_31, R_32, R_33 = kernels.row(body.R, 2)
    tilt = math.atan2(math.hypot(R_31, R_32), R_33)
    speed = math.sqrt(kernels.dot(body.v, body.v))
    throttle, slew = inputs[i, U_THROTTLE], -FREE
    for k in range(3):
        change = _rate_change(inputs, i, k)
        slew = max(slew, change - bound.rate_change_max[k], bound.rate_change_min[k] - change)
    return (
        tilt - bound.tilt,
        speed - bound.speed,
        max(throttle - bound.throttle_max, bound.throttle_min - throttle),
        slew,
    )


@compiled
def _half_space_excess(p: kernels.Vector, normals: Array, offsets: Array) -> float:
    """Return the distance of a position beyond the farthest plane, negative inside."""
    most = -FREE
    for j in range(len(offsets)):
        if offsets[j] < FREE:
            most = max(most, kernels.dot(kernels.vector(normals[j]), p) - offsets[j])
    return most


@compiled
def _planned_inputs(target: RecordArray[TargetStage], plan: PlannedTrajectory) -> Array:
    """Return the mean inputs of the stages of a plan (N, 4)."""
    inputs = np.empty_like(plan.deviation)
    for i in range(len(inputs)):
        for k in range(INPUT_SIZE):
            inputs[i, k] = target[i].mean_input[k] + plan.deviation[i, k]
    return inputs


@compiled
def _rate_change(inputs: Array, i: int, k: int) -> float:
    """Return the planned change of a rate since the stage before; in the first the rate."""
    return float(inputs[i, U_RATE + k] - (inputs[i - 1, U_RATE + k] if i > 0 else 0.0))


@compiled
def write_limits(
    limits: Limits,
    target: RecordArray[TargetStage],
    plan: PlannedTrajectory,
    stages: HorizonStages,
) -> tuple[float, float]:
    """Write soft rows and weights about a plan; return its penalty and constraint activity.

    The stages have the rest of the QP about it.
    """
    n, nx, nu = stages.B.shape
    x = 2 * nu  # first column of the state
    slopes, weights, inputs = np.empty((n, nx)), limits.weights, _planned_inputs(target, plan)
    _write_weights(stages, weights, slopes)
    for i in range(n):
        rows, offsets = stages.normals[i], stages.offsets[i]
        body, bound = body_in(plan.states[i + 1]), limits.bounds[i]
        row = limits.rows[_TILT]
        if row >= 0:
            _write_tilt(body.R, slopes[i], bound.tilt, rows[row:, x:], offsets[row:])
        row = limits.rows[_SPEED]
        if row >= 0:
            offsets[row] = _write_speed(body.v, slopes[i], bound.speed, rows[row, x:])
        row = limits.rows[_THROTTLE]
        if row >= 0:
            throttle, column = inputs[i, U_THROTTLE], nu + U_THROTTLE
            rows[row, column], rows[row + 1, column] = 1.0, -1.0
            offsets[row] = bound.throttle_max - throttle
            offsets[row + 1] = throttle - bound.throttle_min
        row = limits.rows[_SLEW]
        if row >= 0:
            for k in range(3):
                change = _rate_change(inputs, i, k)
                _write_slew(change, bound, k, rows[row + 2 * k :, :x], offsets[row + 2 * k :])
        for j in range(limits.offsets.shape[1]):
            row, n_ij = limits.rows[_HALF_SPACES] + j, kernels.vector(limits.normals[i, j])
            kernels.store_vector(n_ij, rows[row, x + P :])
            b_ij = limits.offsets[i, j]
            offsets[row] = FREE if b_ij >= FREE else b_ij - kernels.dot(n_ij, body.p)
        for kind in range(len(weights)):
            slack = limits.slacks[kind]
            if slack >= 0:
                stages.linear[i, slack] = weights[kind]
                stages.quadratic[i, slack] = weights[kind] * _QUADRATIC[kind] / _TYPICAL[kind]
    return _penalty_and_activity(limits, plan.states, inputs)


@compiled
def _write_slew(change: float, bound: StageBounds, k: int, rows: Array, offsets: Array) -> None:
    """Write the upper and the lower bound of the change of a rate, in columns of the inputs."""
    before, now = U_RATE + k, rows.shape[1] // 2 + U_RATE + k
    rows[0, now], rows[0, before] = 1.0, -1.0
    rows[1, now], rows[1, before] = -1.0, 1.0
    offsets[0] = bound.rate_change_max[k] - change
    offsets[1] = change - bound.rate_change_min[k]


@compiled
def _write_tilt(
    R: kernels.Matrix, slope: Array, bound: float, rows: Array, offsets: Array
) -> None:
    """Write the four sides of the square about the disc of tilts within the bound.

    The columns of ``rows`` are those of the state.
    """
    R_31, R_32, R_33 = kernels.row(R, 2)
    length = math.hypot(R_31, R_32)
    angle = math.atan2(length, R_33)
    if length > _MIN_TILT:
        x, y, along = R_32 / length, -R_31 / length, angle
        across = 0.0
    else:
        x, y = _direction(-slope[THETA], -slope[THETA + 1])
        # Of the tilt, a vector (R_32, -R_31) where it is small; near pi all directions lead down.
        along, across = R_32 * x - R_31 * y, -R_32 * y - R_31 * x
        if R_33 < 0.0:
            x, y, along, across = -x, -y, angle, 0.0
    sides = (x, y, along), (-x, -y, -along), (-y, x, across), (y, -x, -across)
    for side, (of_x, of_y, own) in enumerate(sides):
        rows[side, THETA], rows[side, THETA + 1] = of_x, of_y
        offsets[side] = bound - own


@compiled
def _direction(x: float, y: float) -> tuple[float, float]:
    """Return the direction of a vector in a plane, any for none."""
    length = math.hypot(x, y)
    if length < 1e-12:
        return 1.0, 0.0
    return x / length, y / length


@compiled
def _write_speed(v: kernels.Vector, slope: Array, bound: float, row: Array) -> float:
    """Write the plane that touches the ball of bounded velocities in the velocity's direction.

    Returns its offset. The columns of the ``row`` are those of the state.
    """
    speed = math.sqrt(kernels.dot(v, v))
    n = v
    if speed < _MIN_SPEED:
        n = -slope[V], -slope[V + 1], -slope[V + 2]
    length = math.sqrt(kernels.dot(n, n))
    n = kernels.scaled(1.0 / length, n) if length > 1e-12 else (1.0, 0.0, 0.0)
    kernels.store_vector(n, row[V:])
    return bound - kernels.dot(n, v)


@compiled
def _write_weights(stages: HorizonStages, weights: Array, slopes: Array) -> None:
    """Write the slopes (N, nx) of the cost in states 1 to N, and the weights (5,) from them."""
    n, nx = slopes.shape
    for kind in range(len(weights)):
        weights[kind] = _LEAST_WEIGHT / _TYPICAL[kind]
    weights[_HALF_SPACES] = _LEAST_HALF_SPACE_WEIGHT
    rate_slopes = np.zeros(3)
    for i in range(n - 1, -1, -1):
        for k in range(nx):
            slope = stages.g[i, k]
            if i < n - 1:
                for j in range(nx):
                    slope += stages.A[i + 1, j, k] * slopes[i + 1, j]
            slopes[i, k] = slope
        p = slopes[i]
        _raise(weights, _TILT, _SLOPE_SHARE * math.hypot(p[THETA], p[THETA + 1]))
        by_p = math.sqrt(p[P] ** 2 + p[P + 1] ** 2 + p[P + 2] ** 2)
        by_v = math.sqrt(p[V] ** 2 + p[V + 1] ** 2 + p[V + 2] ** 2)
        _raise(weights, _SPEED, _SLOPE_SHARE * by_v)
        _raise(weights, _HALF_SPACES, _HALF_SPACE_SLOPE * by_p)
        _raise(weights, _HALF_SPACES, _HALF_SPACE_SLOPE * by_v / _SWERVE_TIME)
        for k in range(INPUT_SIZE):
            slope = stages.r[i, k]
            for j in range(nx):
                slope += stages.B[i, j, k] * p[j]
            if k == 0:
                _raise(weights, _THROTTLE, _SLOPE_SHARE * abs(slope))
            else:  # a change of the rates lasts
                rate_slopes[k - 1] += slope
                _raise(weights, _SLEW, _SLOPE_SHARE * abs(rate_slopes[k - 1]))
    least = _LEAST_SHARE * _steepest_slope(weights)
    for kind in range(_HALF_SPACES):
        _raise(weights, kind, least / _TYPICAL[kind])


@compiled
def _raise(weights: Array, kind: int, least: float) -> None:
    weights[kind] = max(weights[kind], least)
