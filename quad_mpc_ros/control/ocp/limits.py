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
changes of the plan cost something (:func:`regularise`), in proportion to the slopes. A reference
far away pulls as if it were near (:func:`pull_target_closer`), else height would be given away for
speed.
"""

from __future__ import annotations

import math

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, RecordArray, Vector3
from quad_mpc_ros.control.config import LimitParameters
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.rollout import SUBSTEPS, StateRecord, body_in
from quad_mpc_ros.control.model.state import INPUT_SIZE, THETA, U_RATE, U_THROTTLE, V
from quad_mpc_ros.control.ocp.half_spaces import (
    HalfSpaces,
    half_space_penalty,
    pattern_of,
    write_half_spaces,
)
from quad_mpc_ros.control.ocp.horizon_qp import FREE
from quad_mpc_ros.control.ocp.settings import Settings, values_of
from quad_mpc_ros.control.ocp.stages import HorizonStages, LimitPattern
from quad_mpc_ros.control.ocp.target import TargetStage
from quad_mpc_ros.control.ocp.trajectory import PlannedTrajectory

# The kinds, in the order of their rows: tilt, speed, throttle, and change of the rates.
_TILT, _SPEED, _THROTTLE, _SLEW = range(4)
_ROWS = np.array([4, 1, 2, 6])
# What a violation of each typically is, and by what the solver measures it.
_TYPICAL = np.array([0.5, 3.0, 0.3, 2.5])
_SIZES = np.array([0.5, 1.0, 0.3, 2.5])


class Allowed(Record):
    """What the limits allow in a stage; ``FREE``, or less, where nothing is limited."""

    tilt: float  # rad
    speed: float  # m/s
    throttle_min: float
    throttle_max: float
    # Change of the rates since the stage before [rad/s]; in the first the rates themselves.
    rate_change_min: Vector3
    rate_change_max: Vector3


class LimitPlace(Record):
    """Where a kind of limit stands in a stage: its first row and its slack, -1 for none."""

    row: int
    slack: int


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

    ``places`` (4,) are those of each kind. After them come ``half_spaces`` on the position.
    Columns are the ``inputs`` of the stage before, those of this one, and the state at its end.
    """

    def __init__(
        self, limits: LimitParameters, *, half_spaces: int = 0, inputs: int = INPUT_SIZE
    ) -> None:
        self._inputs = inputs
        has = values_of(limits) > 0.0
        ends, slacks = np.cumsum(np.where(has, _ROWS, 0)), np.cumsum(has)
        self.places = LimitPlace.zeros(len(has))
        self.places["row"] = np.where(has, ends - _ROWS, -1)
        self.places["slack"] = np.where(has, slacks - 1, -1)
        self.kinds = np.flatnonzero(has)
        self._count = half_spaces
        self._row, self._slack = int(ends[-1]), int(slacks[-1])
        self.rows, self.slacks = self._row + half_spaces, self._slack + min(half_spaces, 1)

    def half_spaces(self, steps: int) -> HalfSpaces:
        """Return room for the half-spaces of so many stages."""
        return HalfSpaces.zeros(steps, self._count, row=self._row, slack=self._slack)

    def pattern(self, nx: int) -> LimitPattern:
        """Return which entries the rows have, with ``nx`` states."""
        nu = self._inputs
        state = 2 * nu
        masks = [np.zeros((count, 2 * nu + nx), dtype=bool) for count in _ROWS]
        masks[_TILT][:, state + THETA : state + THETA + 2] = True
        masks[_SPEED][:, state + V : state + THETA] = True
        masks[_THROTTLE][:, nu + U_THROTTLE] = True
        for k in range(3):
            masks[_SLEW][2 * k : 2 * k + 2, [U_RATE + k, nu + U_RATE + k]] = True
        own = pattern_of(self._count, nx=nx, nu=nu)
        slack_of = np.repeat(np.arange(self._slack), _ROWS[self.kinds])
        return LimitPattern(
            mask=np.vstack([*(masks[kind] for kind in self.kinds), own.mask]),
            slack_of=np.concatenate((slack_of, self._slack + own.slack_of)),
            slack_size=np.concatenate((_SIZES[self.kinds], own.slack_size)),
        )


@compiled
def allow(
    given: Settings,
    sent: Array,
    since: float,
    target: RecordArray[TargetStage],
    allowed: RecordArray[Allowed],
) -> None:
    """Write what the limits allow (N,) along a target.

    The command ``sent`` (4,) last was sent ``since`` seconds ago, infinity if there is none. What
    is not limited may be anything up to ``FREE``.
    """
    limits = given.limits
    for i in range(len(allowed)):
        stage, may = target[i], allowed[i]
        own = math.acos(kernels.clamp(stage.R_WB[2, 2], -1.0, 1.0))
        tilt = max(limits[_TILT], own + TILT_MARGIN)
        may.tilt = tilt if limits[_TILT] > 0.0 and tilt < math.pi else FREE
        v = kernels.vector(stage.v_WB_W)
        speed = max(limits[_SPEED], math.sqrt(kernels.dot(v, v)) + SPEED_MARGIN)
        may.speed = speed if limits[_SPEED] > 0.0 else FREE
        margin, throttle = limits[_THROTTLE], stage.mean_input[U_THROTTLE]
        has_margin = margin > 0.0
        least = min(given.u_min[U_THROTTLE] + margin, throttle - _THROTTLE_MARGIN)
        most = max(given.u_max[U_THROTTLE] - margin, throttle + _THROTTLE_MARGIN)
        may.throttle_min = least if has_margin else -FREE
        may.throttle_max = most if has_margin else FREE
        duration = since if i == 0 else given.step
        for k in range(3):
            rate = U_RATE + k
            if i == 0:  # as it changes within the stage
                first, last = stage.inputs[0, rate], stage.inputs[SUBSTEPS - 1, rate]
                before, by_itself = sent[rate], (last - first) / (SUBSTEPS - 1)
                by_itself *= SUBSTEPS / given.step * since
            else:
                before = 0.0
                by_itself = stage.mean_input[rate] - target[i - 1].mean_input[rate]
            change = limits[_SLEW] * duration
            has_slew = limits[_SLEW] > 0.0 and change < FREE
            fall, rise = min(by_itself, 0.0) - change, max(by_itself, 0.0) + change
            may.rate_change_min[k] = before + fall if has_slew else -FREE
            may.rate_change_max[k] = before + rise if has_slew else FREE


@compiled
def flips(given: Settings, R_start: kernels.Matrix, target: RecordArray[TargetStage]) -> bool:
    """Whether the thrust axis of a target turns faster somewhere than body rates are bounded to.

    As it does near free fall, where the direction of little thrust means little. ``R_start`` is
    the attitude at the start of the first stage.
    """
    u_max = given.u_max
    before = kernels.column(R_start, 2)
    slowest = math.cos(min(max(u_max[1], u_max[2]) * given.step, math.pi))
    for i in range(len(target)):
        after, cosine = kernels.column(kernels.matrix(target[i].R_WB), 2), 0.0
        for k in range(3):
            cosine += before[k] * after[k]
        if cosine < slowest:
            return True
        before = after
    return False


@compiled
def allow_any_tilt(allowed: RecordArray[Allowed]) -> None:
    """Limit the tilt in no stage."""
    for i in range(len(allowed)):
        allowed[i].tilt = FREE


@compiled
def pull_target_closer(
    given: Settings, start: StateRecord, target: RecordArray[TargetStage]
) -> None:
    """Move the positions of a target so that the first is no further away than a distance.

    From the state ``start``, across and in height each: what is far away does not make little of
    the height.
    """
    first, distance = target[0], given.distance
    x, y, z = (
        start.p_WB[0] - first.p_WB[0] + given.step * first.v_WB_W[0],
        start.p_WB[1] - first.p_WB[1] + given.step * first.v_WB_W[1],
        start.p_WB[2] - first.p_WB[2] + given.step * first.v_WB_W[2],
    )
    across = 1.0 - distance / max(math.hypot(x, y), distance)
    height = 1.0 - distance / max(abs(z), distance)
    for i in range(len(target)):
        p_WB = target[i].p_WB
        p_WB[0] += across * x
        p_WB[1] += across * y
        p_WB[2] += height * z


@compiled
def regularise(
    R: Array, prices: Array, closeness: float, steep: float, stages: HorizonStages
) -> float:
    """Make changes of the plan cost something, lest a step be all or nothing.

    ``R`` (4,) are the weights on its inputs. It is in proportion to the steepest slope that there
    is, and to how close the plan is to a limit, or the slope to a ``steep`` one, which is
    returned. Where the iterations converge stays the same.
    """
    slope = steepest_slope(prices)
    steepest = max(closeness, min(1.0, slope / steep)) * slope
    H = stages.H
    for i in range(len(H)):
        stages.R[i, U_THROTTLE] = R[U_THROTTLE] + _DAMPING_THROTTLE * steepest
        for k in range(3):
            stages.R[i, U_RATE + k] = R[U_RATE + k] + _DAMPING_RATES * steepest
            H[i, V + k, V + k] += _DAMPING_VELOCITY * steepest
            H[i, THETA + k, THETA + k] += _DAMPING_ATTITUDE * steepest
    return steepest


@compiled
def steepest_slope(prices: Array) -> float:
    """Return the steepest slope of the cost, per typical change of attitude or velocity."""
    steepest = max(prices[_TILT] * _TYPICAL[_TILT], prices[_SPEED] * _TYPICAL[_SPEED])
    return float(steepest / _SLOPE)


@compiled
def closeness(
    states: RecordArray[StateRecord], inputs: Array, allowed: RecordArray[Allowed]
) -> float:
    """Return 1 for a plan that reaches a limit, 0 for one that is well inside of all."""
    most = 0.0
    for i in range(len(allowed)):
        beyond = _beyond(i, states, inputs, allowed)
        for kind in range(len(beyond)):
            most = max(most, 1.0 + beyond[kind] / _NEAR[kind])
    return min(most, 1.0)


@compiled
def penalty(
    states: RecordArray[StateRecord],
    inputs: Array,
    allowed: RecordArray[Allowed],
    prices: Array,
    half_spaces: HalfSpaces,
) -> float:
    """Return what it costs that states 0 to N (N + 1,) and inputs (N, 4) break limits.

    It is in the units of the tracking cost, which is twice that of the QP.
    """
    cost = half_space_penalty(half_spaces, states)
    for i in range(len(allowed)):
        beyond = _beyond(i, states, inputs, allowed)
        for kind in range(len(beyond)):
            cost += _paid(kind, prices, beyond[kind])
    return cost


@compiled
def _beyond(
    i: int, states: RecordArray[StateRecord], inputs: Array, allowed: RecordArray[Allowed]
) -> tuple[float, float, float, float]:
    """Return by how much a stage is beyond each limit, negative inside."""
    body, may = body_in(states[i + 1]), allowed[i]
    R_31, R_32, R_33 = kernels.row(body.R, 2)
    tilt = math.atan2(math.hypot(R_31, R_32), R_33)
    speed = math.sqrt(kernels.dot(body.v, body.v))
    throttle, change = inputs[i, U_THROTTLE], -FREE
    for k in range(3):
        turned = inputs[i, U_RATE + k] - (inputs[i - 1, U_RATE + k] if i > 0 else 0.0)
        change = max(change, turned - may.rate_change_max[k], may.rate_change_min[k] - turned)
    return (
        tilt - may.tilt,
        speed - may.speed,
        max(throttle - may.throttle_max, may.throttle_min - throttle),
        change,
    )


@compiled
def _paid(kind: int, prices: Array, beyond: float) -> float:
    if beyond <= 0.0:
        return 0.0
    return float(2.0 * prices[kind] * beyond * (1.0 + 0.5 * _SQUARE / _TYPICAL[kind] * beyond))


@compiled
def write_limits(
    places: RecordArray[LimitPlace],
    target: RecordArray[TargetStage],
    plan: PlannedTrajectory,
    allowed: RecordArray[Allowed],
    prices: Array,
    half_spaces: HalfSpaces,
    stages: HorizonStages,
) -> tuple[float, float]:
    """Write soft rows and prices (4,) about a plan; return what it pays, and its closeness.

    The stages have the rest of the QP about it.
    """
    n, nx, nu = stages.B.shape
    state = 2 * nu
    slopes = np.empty((n, nx))
    _write_prices(stages, prices, slopes)
    write_half_spaces(half_spaces, plan.states, slopes, stages)
    inputs = np.empty((n, INPUT_SIZE))
    for i in range(n):
        for k in range(INPUT_SIZE):
            inputs[i, k] = target[i].mean_input[k] + plan.deviation[i, k]
        rows, offsets = stages.normals[i], stages.offsets[i]
        body, may = body_in(plan.states[i + 1]), allowed[i]
        first = places[_TILT].row
        if first >= 0:
            _write_tilt(body.R, slopes[i], may.tilt, rows[first:, state:], offsets[first:])
        first = places[_SPEED].row
        if first >= 0:
            offsets[first] = _write_speed(body.v, slopes[i], may.speed, rows[first, state:])
        first = places[_THROTTLE].row
        if first >= 0:
            column = nu + U_THROTTLE
            rows[first, column], rows[first + 1, column] = 1.0, -1.0
            offsets[first] = may.throttle_max - inputs[i, U_THROTTLE]
            offsets[first + 1] = inputs[i, U_THROTTLE] - may.throttle_min
        if places[_SLEW].row >= 0:
            for k in range(3):
                first = places[_SLEW].row + 2 * k
                rate = U_RATE + k
                change = inputs[i, rate] - (inputs[i - 1, rate] if i > 0 else 0.0)
                for side in range(2):
                    sign = 1.0 - 2.0 * side
                    rows[first + side, nu + rate] = sign
                    rows[first + side, rate] = -sign
                offsets[first] = may.rate_change_max[k] - change
                offsets[first + 1] = change - may.rate_change_min[k]
        for kind in range(len(places)):
            slack = places[kind].slack
            if slack >= 0:
                stages.linear[i, slack] = prices[kind]
                stages.quadratic[i, slack] = prices[kind] * _SQUARE / _TYPICAL[kind]
    paid = penalty(plan.states, inputs, allowed, prices, half_spaces)
    return paid, closeness(plan.states, inputs, allowed)


@compiled
def _write_tilt(
    R: kernels.Matrix, slope: Array, allowed: float, rows: Array, offsets: Array
) -> None:
    """Write the four sides of the square about the disc of tilts allowed.

    The columns of ``rows`` are those of the state.
    """
    R_31, R_32, R_33 = kernels.row(R, 2)
    length = math.hypot(R_31, R_32)
    angle = math.atan2(length, R_33)
    if length > _NO_TILT:
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
        offsets[side] = allowed - own


@compiled
def _direction(x: float, y: float) -> tuple[float, float]:
    """Return the direction of a vector in a plane, any for none."""
    length = math.hypot(x, y)
    if length < 1e-12:
        return 1.0, 0.0
    return x / length, y / length


@compiled
def _write_speed(v: kernels.Vector, slope: Array, allowed: float, row: Array) -> float:
    """Write the plane that touches the ball of velocities allowed in the velocity's direction.

    Returns its offset. The columns of the ``row`` are those of the state.
    """
    speed = math.sqrt(kernels.dot(v, v))
    n = v
    if speed < _NO_SPEED:
        n = -slope[V], -slope[V + 1], -slope[V + 2]
    length = math.sqrt(kernels.dot(n, n))
    n = kernels.scaled(1.0 / length, n) if length > 1e-12 else (1.0, 0.0, 0.0)
    kernels.store_vector(n, row[V:])
    return allowed - kernels.dot(n, v)


@compiled
def _write_prices(stages: HorizonStages, prices: Array, slopes: Array) -> None:
    """Write the slopes (N, nx) of the cost in the states 1 to N, and the prices (4,) of them."""
    n, nx = slopes.shape
    for kind in range(len(prices)):
        prices[kind] = _LEAST_PRICE / _TYPICAL[kind]
    turning = np.zeros(3)
    for i in range(n - 1, -1, -1):
        for k in range(nx):
            slope = stages.g[i, k]
            if i < n - 1:
                for j in range(nx):
                    slope += stages.A[i + 1, j, k] * slopes[i + 1, j]
            slopes[i, k] = slope
        p = slopes[i]
        _raise(prices, _TILT, _SLOPE * math.hypot(p[THETA], p[THETA + 1]))
        by_v = p[V] ** 2 + p[V + 1] ** 2 + p[V + 2] ** 2
        _raise(prices, _SPEED, _SLOPE * math.sqrt(by_v))
        for k in range(INPUT_SIZE):
            slope = stages.r[i, k]
            for j in range(nx):
                slope += stages.B[i, j, k] * p[j]
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
