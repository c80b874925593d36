"""Soft limits on the plan: what they allow, their rows of the QP, and what breaking them costs.

    tilt_i <= tilt allowed,   |v_i| <= speed allowed                              i = 1..N
    throttle_i and the rates' change from u_{i-1} to u_i between bounds           i = 0..N-1

Each is eased by one slack a stage, of price c s + 1/2 d s^2. A limit bounds what the controller
adds: where the reference asks for more by itself, it may have that and a margin. u_{-1} is the
command sent last.

Rows are linear in what changes about a rollout. The tilt is a vector in the plane of the body's x
and y axes, as long as the angle between thrust axis and up. A turn R exp([φ]) lengthens it by

    dθ = (R_32 φ_x - R_31 φ_y) / sin θ

and a turn about the perpendicular direction leaves its length: four rows make a square about the
disc, one side of which touches it where the rollout is. Level there is no such direction, and that
in which the cost falls stands in for it.

c is about what the tracking cost would pay at most for easing a limit, so that a limit is broken
only where it cannot be kept. That is found at the rollout, anew for each problem: the slopes p_i
of the cost of what follows, by p_i = g_i + A_i' p_{i+1}. A price once and for all would have to
suit the largest jump, and a solver's tolerance grows with the largest number in its problem.

Near a limit the best step is all or nothing, and a first-order solver takes long to find it. There
changes of the plan cost something (:func:`damp`), in proportion to the slopes. A reference far
away pulls as if it were near (:func:`draw_near`), else height would be given away for speed.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.config import LimitParameters
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.rollout import SUBSTEPS, body_in
from quad_mpc_ros.control.model.state import INPUT_SIZE
from quad_mpc_ros.control.ocp.horizon_qp import FREE
from quad_mpc_ros.control.ocp.stages import LimitPattern, Shape, StageParts, stages_in
from quad_mpc_ros.control.ocp.target import target_in
from quad_mpc_ros.control.ocp.trajectory import trajectory_in

# The kinds, in the order of their rows: tilt, speed, throttle, and change of the rates.
_TILT, _SPEED, _THROTTLE, _SLEW = range(4)
_ROWS = np.array([4, 1, 2, 6])
# What a violation of each typically is, and by what the solver measures it.
_TYPICAL = np.array([0.5, 3.0, 0.3, 2.5])
_SIZES = np.array([0.5, 1.0, 0.3, 2.5])

ALLOWED_SIZE = 10
"""Of a stage: tilt, speed, least and largest throttle, least and largest change of the rates."""
_LEAST, _MOST, _FALL, _RISE = 2, 3, 4, 7

# What a reference may have beyond what it asks for: tilt [rad], speed [m/s], throttle.
TILT_MARGIN, SPEED_MARGIN, _THROTTLE_MARGIN = 0.3, 1.0, 0.1
# Prices: this share of a slope, which is that of all stages that follow together; of a typical
# violation at least this, and at least this share of the steepest slope; and the quadratic price
# as a share of the linear one.
_SLOPE, _LEAST_PRICE, _STEEP, _SQUARE = 0.8, 0.4, 0.2, 0.5
# A plan as near to a limit as this feels that it is there.
_NEAR = np.array([0.2, 0.5, 0.05, 0.5])
# What a change of the plan costs, as a share of that slope: throttle, rates, velocity, attitude.
_DAMPING_THROTTLE = 0.02 / 0.3**2
_DAMPING_RATES = 0.2 / 5.0**2
_DAMPING_VELOCITY = 0.03 / 3.0**2
_DAMPING_ATTITUDE = 0.03 / 0.5**2
# Below this tilt [rad] or speed [m/s] its direction says little of where it will be.
_NO_TILT, _NO_SPEED = 0.05, 0.3


class LimitLayout:
    """Which limits a configuration has, and where their rows and slacks are.

    ``starts`` (4, 2): first row and slack of each kind, -1 for those without.
    """

    def __init__(self, limits: LimitParameters) -> None:
        has = values_of(limits) > 0.0
        ends = np.cumsum(np.where(has, _ROWS, 0)), np.cumsum(has)
        starts = np.column_stack((ends[0] - _ROWS, ends[1] - 1))
        self.starts = np.where(has[:, None], starts, -1)
        self.kinds = np.flatnonzero(has)
        self.rows, self.slacks = int(ends[0][-1]), int(ends[1][-1])

    def pattern(self, nx: int) -> LimitPattern:
        """Return which entries the rows have, with ``nx`` states."""
        nu = INPUT_SIZE
        masks = [np.zeros((count, 2 * nu + nx), dtype=bool) for count in _ROWS]
        masks[_TILT][:, 2 * nu + 6 : 2 * nu + 8] = True
        masks[_SPEED][:, 2 * nu + 3 : 2 * nu + 6] = True
        masks[_THROTTLE][:, nu] = True
        for k in range(3):
            masks[_SLEW][2 * k : 2 * k + 2, [1 + k, nu + 1 + k]] = True
        empty = np.zeros((0, 2 * nu + nx), dtype=bool)
        return LimitPattern(
            mask=np.vstack([empty, *(masks[kind] for kind in self.kinds)]),
            slack_of=np.repeat(np.arange(self.slacks), _ROWS[self.kinds]),
            slack_size=_SIZES[self.kinds],
        )


def values_of(limits: LimitParameters) -> Array:
    """Return the limits (4,) by kind, 0 for those there are not."""
    return np.array([limits.tilt_max, limits.speed_max, limits.throttle_margin, limits.rate_slew])


@compiled
def allow(
    limits: Array,
    step: float,
    u_min: Array,
    u_max: Array,
    sent: Array,
    since: float,
    target: Array,
    allowed: Array,
) -> None:
    """Write what limits (4,) allow (N, 10) along a target of stages of ``step`` seconds.

    The command ``sent`` (4,) last was sent ``since`` seconds ago, infinity if there is none. What
    is not limited may be anything up to ``FREE``.
    """
    tracked = target_in(target)
    for i in range(len(allowed)):
        own = math.acos(kernels.clamp(tracked.R_WB[i, 2, 2], -1.0, 1.0))
        tilt = max(limits[_TILT], own + TILT_MARGIN)
        allowed[i, _TILT] = tilt if limits[_TILT] > 0.0 and tilt < math.pi else FREE
        v = kernels.vector(tracked.v_WB_W[i])
        speed = max(limits[_SPEED], math.sqrt(kernels.dot(v, v)) + SPEED_MARGIN)
        allowed[i, _SPEED] = speed if limits[_SPEED] > 0.0 else FREE
        margin, throttle = limits[_THROTTLE], tracked.mean_inputs[i, 0]
        has_margin = margin > 0.0
        least = min(u_min[0] + margin, throttle - _THROTTLE_MARGIN)
        most = max(u_max[0] - margin, throttle + _THROTTLE_MARGIN)
        allowed[i, _LEAST] = least if has_margin else -FREE
        allowed[i, _MOST] = most if has_margin else FREE
        duration = since if i == 0 else step
        for k in range(3):
            if i == 0:  # as it changes within the stage
                inputs, last = tracked.inputs[0, :, 1 + k], SUBSTEPS - 1
                before, by_itself = sent[1 + k], (inputs[last] - inputs[0]) / last
                by_itself *= SUBSTEPS / step * since
            else:
                before = 0.0
                by_itself = tracked.mean_inputs[i, 1 + k] - tracked.mean_inputs[i - 1, 1 + k]
            change = limits[_SLEW] * duration
            has_slew = limits[_SLEW] > 0.0 and change < FREE
            fall, rise = min(by_itself, 0.0) - change, max(by_itself, 0.0) + change
            allowed[i, _FALL + k] = before + fall if has_slew else -FREE
            allowed[i, _RISE + k] = before + rise if has_slew else FREE


@compiled
def flips(step: float, u_max: Array, target: Array) -> bool:
    """Whether the thrust axis of a target turns faster somewhere than body rates are bounded to.

    As it does near free fall, where the direction of little thrust means little. The stages are of
    ``step`` seconds.
    """
    tracked = target_in(target)
    before, slowest = tracked.R_WB_start, math.cos(min(max(u_max[1], u_max[2]) * step, math.pi))
    for i in range(len(tracked.R_WB)):
        after, cosine = tracked.R_WB[i], 0.0
        for k in range(3):
            cosine += before[k, 2] * after[k, 2]
        if cosine < slowest:
            return True
        before = after
    return False


@compiled
def let_tilt(allowed: Array) -> None:
    """Allow any tilt."""
    allowed[:, _TILT] = FREE


@compiled
def draw_near(step: float, start: Array, distance: float, target: Array) -> None:
    """Move the positions of a target to where the first is no further away than a distance.

    From the state ``start`` (19,), across and in height each: what is far away does not make
    little of the height. The stages are of ``step`` seconds.
    """
    tracked = target_in(target)
    x, y, z = (
        start[0] - tracked.p_WB[0, 0] + step * tracked.v_WB_W[0, 0],
        start[1] - tracked.p_WB[0, 1] + step * tracked.v_WB_W[0, 1],
        start[2] - tracked.p_WB[0, 2] + step * tracked.v_WB_W[0, 2],
    )
    across = 1.0 - distance / max(math.hypot(x, y), distance)
    height = 1.0 - distance / max(abs(z), distance)
    for i in range(len(tracked.p_WB)):
        tracked.p_WB[i, 0] += across * x
        tracked.p_WB[i, 1] += across * y
        tracked.p_WB[i, 2] += height * z


@compiled
def damp(
    R: Array, prices: Array, closeness: float, steep: float, shape: Shape, stages: Array
) -> None:
    """Let changes of the plan cost something, lest a step be all or nothing.

    ``R`` (4,) are the weights on its inputs. It is in proportion to the steepest slope that there
    is, and to how close the plan is to a limit, or the slope to a ``steep`` one. What changes no
    more costs what it did, so where the iterations lead stays the same.
    """
    slope = steepest_slope(prices)
    steepest = max(closeness, min(1.0, slope / steep)) * slope
    given = stages_in(shape, stages)
    state_cost, input_terms = given.state_cost, given.input_terms
    for i in range(len(input_terms)):
        input_terms[i, 0, 0] = R[0] + _DAMPING_THROTTLE * steepest
        for k in range(3):
            input_terms[i, 0, 1 + k] = R[1 + k] + _DAMPING_RATES * steepest
            state_cost[i, 3 + k, 3 + k] += _DAMPING_VELOCITY * steepest
            state_cost[i, 6 + k, 6 + k] += _DAMPING_ATTITUDE * steepest


@compiled
def steepest_slope(prices: Array) -> float:
    """Return the steepest slope of the cost, per typical change of attitude or velocity."""
    steepest = max(prices[_TILT] * _TYPICAL[_TILT], prices[_SPEED] * _TYPICAL[_SPEED])
    return float(steepest / _SLOPE)


@compiled
def closeness(states: Array, inputs: Array, allowed: Array) -> float:
    """Return 1 for a plan that reaches a limit, 0 for one that is well inside of all."""
    most = 0.0
    for i in range(len(allowed)):
        beyond = _beyond(i, states, inputs, allowed)
        for kind in range(len(beyond)):
            most = max(most, 1.0 + beyond[kind] / _NEAR[kind])
    return min(most, 1.0)


@compiled
def penalty(states: Array, inputs: Array, allowed: Array, prices: Array) -> float:
    """Return what it costs that states 0 to N (N + 1, 19) and inputs (N, 4) break limits.

    It is in the units of the tracking cost, which is twice that of the QP.
    """
    cost = 0.0
    for i in range(len(allowed)):
        beyond = _beyond(i, states, inputs, allowed)
        for kind in range(len(beyond)):
            cost += _paid(kind, prices, beyond[kind])
    return cost


@compiled
def _beyond(
    i: int, states: Array, inputs: Array, allowed: Array
) -> tuple[float, float, float, float]:
    """Return by how much a stage is beyond each limit, negative inside."""
    body = body_in(states[i + 1])
    tilt = math.atan2(math.hypot(body.R[6], body.R[7]), body.R[8])
    speed = math.sqrt(kernels.dot(body.v, body.v))
    throttle, change = inputs[i, 0], -FREE
    for k in range(3):
        turned = inputs[i, 1 + k] - (inputs[i - 1, 1 + k] if i > 0 else 0.0)
        change = max(change, turned - allowed[i, _RISE + k], allowed[i, _FALL + k] - turned)
    return (
        tilt - allowed[i, _TILT],
        speed - allowed[i, _SPEED],
        max(throttle - allowed[i, _MOST], allowed[i, _LEAST] - throttle),
        change,
    )


@compiled
def _paid(kind: int, prices: Array, beyond: float) -> float:
    if beyond <= 0.0:
        return 0.0
    return float(2.0 * prices[kind] * beyond * (1.0 + 0.5 * _SQUARE / _TYPICAL[kind] * beyond))


@compiled
def write_limits(
    starts: NDArray[np.int64],
    target: Array,
    nominal: Array,
    allowed: Array,
    prices: Array,
    shape: Shape,
    stages: Array,
) -> tuple[float, float]:
    """Write soft rows and prices (4,) about a plan; return what it pays, and its closeness.

    The stages have the rest of the QP about it.
    """
    tracked, plan, given = target_in(target), trajectory_in(nominal), stages_in(shape, stages)
    limits, slack_cost = given.limits, given.slack_cost
    n, nx = len(given.dynamics), len(given.x0)
    slopes = np.empty((n, nx))
    _write_prices(given, prices, slopes)
    inputs = np.empty((n, INPUT_SIZE))
    for i in range(n):
        for k in range(INPUT_SIZE):
            inputs[i, k] = tracked.mean_inputs[i, k] + plan.deviation[i, k]
        rows, body = limits[i], body_in(plan.states[i + 1])
        if starts[_TILT, 0] >= 0:
            _write_tilt(body.R, slopes[i], allowed[i, _TILT], rows[starts[_TILT, 0] :])
        if starts[_SPEED, 0] >= 0:
            _write_speed(body.v, slopes[i], allowed[i, _SPEED], rows[starts[_SPEED, 0]])
        if starts[_THROTTLE, 0] >= 0:
            first = starts[_THROTTLE, 0]
            rows[first, INPUT_SIZE], rows[first + 1, INPUT_SIZE] = 1.0, -1.0
            rows[first, -1] = allowed[i, _MOST] - inputs[i, 0]
            rows[first + 1, -1] = inputs[i, 0] - allowed[i, _LEAST]
        if starts[_SLEW, 0] >= 0:
            for k in range(3):
                first = starts[_SLEW, 0] + 2 * k
                change = inputs[i, 1 + k] - (inputs[i - 1, 1 + k] if i > 0 else 0.0)
                for side in range(2):
                    sign = 1.0 - 2.0 * side
                    rows[first + side, INPUT_SIZE + 1 + k] = sign
                    rows[first + side, 1 + k] = -sign
                rows[first, -1] = allowed[i, _RISE + k] - change
                rows[first + 1, -1] = change - allowed[i, _FALL + k]
        for kind in range(len(starts)):
            slack = starts[kind, 1]
            if slack >= 0:
                slack_cost[i, slack, 0] = prices[kind]
                slack_cost[i, slack, 1] = prices[kind] * _SQUARE / _TYPICAL[kind]
    paid = penalty(plan.states, inputs, allowed, prices)
    return paid, closeness(plan.states, inputs, allowed)


@compiled
def _write_tilt(R: kernels.Matrix, slope: Array, allowed: float, rows: Array) -> None:
    """Write the four sides of the square about the disc of tilts allowed."""
    length = math.hypot(R[6], R[7])
    angle = math.atan2(length, R[8])
    if length > _NO_TILT:
        x, y, along = R[7] / length, -R[6] / length, angle
        across = 0.0
    else:
        x, y = _direction(-slope[6], -slope[7])
        # Of the tilt, a vector (R_32, -R_31) where it is small; near pi all directions lead down.
        along, across = R[7] * x - R[6] * y, -R[7] * y - R[6] * x
        if R[8] < 0.0:
            x, y, along, across = -x, -y, angle, 0.0
    first = 2 * INPUT_SIZE + 6
    for side in range(2):
        sign = 1.0 - 2.0 * side
        rows[side, first], rows[side, first + 1] = sign * x, sign * y
        rows[side, -1] = allowed - sign * along
        rows[2 + side, first], rows[2 + side, first + 1] = -sign * y, sign * x
        rows[2 + side, -1] = allowed - sign * across


@compiled
def _direction(x: float, y: float) -> tuple[float, float]:
    """Return the direction of a vector in a plane, any for none."""
    length = math.hypot(x, y)
    if length < 1e-12:
        return 1.0, 0.0
    return x / length, y / length


@compiled
def _write_speed(v: kernels.Vector, slope: Array, allowed: float, row: Array) -> None:
    """Write the plane that touches the ball of velocities allowed in the velocity's direction."""
    speed = math.sqrt(kernels.dot(v, v))
    n = v
    if speed < _NO_SPEED:
        n = -slope[3], -slope[4], -slope[5]
    length = math.sqrt(kernels.dot(n, n))
    n = kernels.scaled(1.0 / length, n) if length > 1e-12 else (1.0, 0.0, 0.0)
    kernels.store_vector(n, row[2 * INPUT_SIZE + 3 : 2 * INPUT_SIZE + 6])
    row[-1] = allowed - kernels.dot(n, v)


@compiled
def _write_prices(given: StageParts, prices: Array, slopes: Array) -> None:
    """Write the slopes (N, nx) of the cost in the states 1 to N, and the prices (4,) of them."""
    dynamics, state_cost, input_terms = given.dynamics, given.state_cost, given.input_terms
    n, nx = len(dynamics), dynamics.shape[1]
    for kind in range(len(prices)):
        prices[kind] = _LEAST_PRICE / _TYPICAL[kind]
    turning = np.zeros(3)
    for i in range(n - 1, -1, -1):
        for k in range(nx):
            slope = state_cost[i, k, nx]
            if i < n - 1:
                for j in range(nx):
                    slope += dynamics[i + 1, j, k] * slopes[i + 1, j]
            slopes[i, k] = slope
        p = slopes[i]
        _raise(prices, _TILT, _SLOPE * math.hypot(p[6], p[7]))
        _raise(prices, _SPEED, _SLOPE * math.sqrt(p[3] ** 2 + p[4] ** 2 + p[5] ** 2))
        for k in range(INPUT_SIZE):
            slope = input_terms[i, 1, k]
            for j in range(nx):
                slope += dynamics[i, j, nx + k] * p[j]
            if k == 0:
                _raise(prices, _THROTTLE, _SLOPE * abs(slope))
            else:  # a change of the rates lasts
                turning[k - 1] += slope
                _raise(prices, _SLEW, _SLOPE * abs(turning[k - 1]))
    least = _STEEP * steepest_slope(prices)
    for kind in range(len(prices)):
        _raise(prices, kind, least / _TYPICAL[kind])


@compiled
def _raise(prices: Array, kind: int, worth: float) -> None:
    prices[kind] = max(prices[kind], worth)
