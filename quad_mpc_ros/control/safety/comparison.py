# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One step of the comparison of odometry and commands, between two odometries.

===========  ==================================  =======================================
relation     x                                   y
===========  ==================================  =======================================
attitude     turn of the reported attitude       reported body rates
position     change of the reported position     reported velocity, in the world
rates        commanded rates, behind their lag   reported body rates
force        commanded thrust over mass, along   change of the reported velocity, plus
             the reported attitude               gravity
===========  ==================================  =======================================

:mod:`.relations` tests whether both sides are equal. A controller that responds to gusts or
unknown lags does not contradict a relation. A ringing or slow rate loop does, but is not reported
as a contradiction (:mod:`.plausible_loops`). Wind and a wrong mass change the force by a constant,
an offset centre of mass changes the rates: horizontal force and rates are compared relative to
their means (a regression with an intercept). The drag that explains most of the difference is
subtracted. The vertical force is compared directly, within a wide band.
"""

from __future__ import annotations

import enum
import math

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Matrix3, Record, RecordArray, Vector3
from quad_mpc_ros.control.estimation.loop_rates import follow_loops, start_loops
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.actuators import first_order_lag
from quad_mpc_ros.control.model.parameters import ModelParameters, modelled_thrust
from quad_mpc_ros.control.model.samples import Measured
from quad_mpc_ros.control.model.state import Input
from quad_mpc_ros.control.safety.dead_reckoning import Track, dead_reckon, start_track
from quad_mpc_ros.control.safety.plausible_loops import (
    PLAUSIBLE_LOOPS,
    PlausibleRates,
    are_explained,
)
from quad_mpc_ros.control.safety.relations import (
    KinematicPair,
    Pair,
    RelationLimits,
    add_products,
    follow_means,
    forget,
    is_contradicted,
    lowpass,
    lowpass_twice,
    trace,
)

_LOWPASS = 0.15  # s
_ATTITUDE_STAGE, _POSITION_STAGE = 0.04, 0.075  # s, time constants of two equal stages
_UNMODELLED_LAG = 0.1  # s, additional lag of the rates
# Time constant of the largest angular acceleration of each axis, and its lower bound.
_ACCELERATION_TIME, _LEAST_ACCELERATION = 2.0, 3.0  # s, rad/s^2
_ACCELERATION_MARGIN = 1.5  # of the demand over the acceleration shown, which lags
_TRACK_TIME = 1.0  # s, between two starts of dead reckoning
# Vertical force over the commanded thrust, and margins as shares of gravity.
_LEAST_LIFT, _FALLING, _SOME_THRUST = 0.25, 0.9, 0.5
# Commanded thrust over the vertical force, that force over gravity, and speed [m/s] of a vehicle
# that climbs without thrust.
_LEAST_THRUST, _RISING, _RISING_SPEED = 0.25, 1.1, 1.0
_SLOWEST_ROTORS = 0.3  # s, time constant of rotors that slow down
# Distance of the rates from their commands above which a mixer may raise the thrust [rad/s], with
# the weight of yaw, which has the least torque.
_CALM_DEMAND, _YAW_DEMAND = 0.7, 5.0
# A climb without commanded thrust that lasts is reported also with demands; a ballistic climb has
# no such force, as share of gravity.
_LONG_CLIMB, _CARRYING = 2.0, 0.5  # s
# Rotations in rad/s, positions in m/s, forces in m/s^2. The second of a kinematic relation is for
# x as a function of y, which detects values that are too large.
_ATTITUDE = RelationLimits(floor=0.4, share=0.12, least=0.35, twist=0.6)
_ATTITUDE_BACK = RelationLimits(floor=1.5, share=0.12, least=0.35, twist=1.0)
_POSITION = RelationLimits(floor=0.5, share=0.12, least=0.25, twist=0.6)
_POSITION_BACK = RelationLimits(floor=1.5, share=0.12, least=0.35, twist=1.0)
_RATES = RelationLimits(floor=0.15, share=0.15, least=0.1, twist=0.9)
_REVERSED = RelationLimits(floor=0.4, share=0.12, least=-0.4, twist=0.9)
_FORCE = RelationLimits(floor=0.7, share=0.08, least=-0.4, twist=0.69)
_MOST_DRAG = 3.0  # 1/s
# Largest difference of the two sides within a sample: angle, distance, speed, rate.
_ANGLE_STEP, _POSITION_STEP, _SPEED_STEP, _RATE_STEP = 0.08, 0.15, 2.0, 20.0
# Body rates above this are wrong if the attitude turns at less than this share of them.
_MAX_RATE, _MIN_TURN_SHARE = 15.0, 0.25  # rad/s


class Relation(enum.IntEnum):
    """Flags of contradicted relations."""

    ATTITUDE = 1
    POSITION = 2
    RATES = 4
    FORCE = 8
    LIFT = 16
    REVERSED = 32  # rates
    THRUST = 64  # much thrust for long without motion
    CLIMB = 128  # climb without thrust


class ConsistencyState(Record):
    """State of the comparison."""

    model: ModelParameters
    p_WB: Vector3
    v_WB_W: Vector3
    R_WB: Matrix3
    w_WB_B: Vector3
    throttle: float  # behind its lag
    commanded: Vector3  # rad/s, rates behind their lag
    # The same behind an additional, unmodelled lag.
    late_throttle: float
    commanded_late: Vector3
    angular_acceleration: Vector3  # rad/s^2, recent maxima
    unturned_rate: float  # rad/s, body rate of the last sample if the attitude hardly turned
    attitude: KinematicPair
    position: KinematicPair
    rates: Pair
    rates_late: Pair
    plausible: PlausibleRates  # with other rate loops
    # Recent maxima of the thrust [m/s^2], as rotors slow down late, and of the distance of the
    # rates from their commands [rad/s].
    held_thrust: float
    held_demand: float
    climbing: float  # s, for how long the vehicle has climbed without commanded thrust
    force: Pair
    force_late: Pair
    drag: Pair  # y the velocity, x the velocity of the force
    drag_on_force: Pair  # x the velocity, y the velocity of the force
    older: Track
    newer: Track
    track_age: float  # s, of the newer track
    track_time: float  # s, after which a new track starts


@compiled
def compare_step(
    memory: RecordArray[ConsistencyState],
    used: Measured,
    reported: Measured,
    command: Input,
    duration: float,
    is_flying: bool,
    is_on_ground: bool,
    descends: bool,
) -> int:
    """Return the contradicted relations after an odometry.

    Args:
        memory: State of the comparison.
        used: The odometry with jumps replaced, whose velocity is compared with the command.
        reported: The odometry with jumps, whose position, attitude and rates must agree.
        command: The command in effect since the previous odometry.
        duration: Time since the previous odometry [s]; 0 restarts the comparison.
        is_flying: Whether the vehicle certainly flies.
        is_on_ground: Whether the motors idle on the ground.
        descends: Whether the vehicle descends after a contradiction.
    """
    state = memory[()]
    _, q_WB_xyzw, v_WB_B, _ = used
    p_WB, q_reported_xyzw, _, w_WB_B = reported
    R = kernels.rotation(kernels.quaternion_in(q_WB_xyzw))
    R_reported = kernels.rotation(kernels.quaternion_in(q_reported_xyzw))
    p, w = kernels.vector(p_WB), kernels.vector(w_WB_B)
    v = kernels.apply(R, kernels.vector(v_WB_B))
    found = 0
    if duration > 0.0:
        _follow_torque(state, w, duration)
        _follow_command(state, command, duration)
        _compare_motion(state, p, v, R_reported, w, duration)
        if is_on_ground:
            forget(state.rates)
            forget(state.rates_late)
            start_loops(state.plausible, w)
            start_force(memory)
        else:
            _compare_with_command(state, (v, w), R, duration)
            shown = kernels.vector(state.angular_acceleration)
            most = kernels.scaled(_ACCELERATION_MARGIN, shown)
            follow_loops(state.plausible, PLAUSIBLE_LOOPS, command.w_WB_B, w, most, duration)
        found = _contradicted(state, is_flying)
    _follow_tracks(state, (p, v, R), duration, is_flying, descends)
    if duration <= 0.0:
        kernels.store_vector(w, state.commanded)
        kernels.store_vector(w, state.commanded_late)
        start_loops(state.plausible, w)
    kernels.store_vector(p, state.p_WB)
    kernels.store_vector(v, state.v_WB_W)
    kernels.store_matrix(R_reported, state.R_WB)
    kernels.store_vector(w, state.w_WB_B)
    return found


@compiled
def start_force(memory: RecordArray[ConsistencyState]) -> None:
    """Reset the relations of the force to a vehicle at rest."""
    state = memory[()]
    state.held_thrust = state.climbing = 0.0
    for pair in (state.force, state.force_late, state.drag, state.drag_on_force):
        forget(pair)
    for pair in (state.force, state.force_late):
        pair.x[2] = pair.y[2] = pair.mean_x[2] = pair.mean_y[2] = state.model.gravity


@compiled
def _follow_command(state: ConsistencyState, command: Input, duration: float) -> None:
    """Update throttle and rates with a command through their lags."""
    late_kept, _ = first_order_lag(_UNMODELLED_LAG, duration)
    kept, _ = first_order_lag(state.model.thrust_time_constant, duration)
    state.throttle = command.throttle + kept * (state.throttle - command.throttle)
    state.late_throttle = state.throttle + late_kept * (state.late_throttle - state.throttle)
    for k in range(3):
        kept, _ = first_order_lag(state.model.rate_time_constants[k], duration)
        rate = command.w_WB_B[k]
        state.commanded[k] = rate + kept * (state.commanded[k] - rate)
        late = state.commanded[k] + late_kept * (state.commanded_late[k] - state.commanded[k])
        if k == 2:  # yaw has the least torque
            most = state.angular_acceleration[k] * duration
            before = state.commanded_late[k]
            late = kernels.clamp(late, before - most, before + most)
        state.commanded_late[k] = late


@compiled
def _follow_torque(state: ConsistencyState, w: kernels.Vector, duration: float) -> None:
    """Update the recent maxima of the angular acceleration, which saturated rotors limit."""
    kept = math.exp(-duration / _ACCELERATION_TIME)
    for k in range(3):
        observed = abs(w[k] - state.w_WB_B[k]) / duration
        remembered = max(kept * state.angular_acceleration[k], observed)
        state.angular_acceleration[k] = max(remembered, _LEAST_ACCELERATION)


@compiled
def _compare_motion(
    state: ConsistencyState,
    p: kernels.Vector,
    v: kernels.Vector,
    R: kernels.Matrix,
    w: kernels.Vector,
    duration: float,
) -> None:
    """Compare attitude with rates, and position with velocity, since the previous odometry."""
    per_second = 1.0 / duration
    turn = kernels.log(kernels.multiply(kernels.transposed(kernels.matrix(state.R_WB)), R))
    turn, far = kernels.scaled(per_second, turn), _ANGLE_STEP * per_second
    # Rates may change abruptly: use the rate between both samples that is nearest to the turn.
    before = kernels.vector(state.w_WB_B)
    rate = (
        _between(turn[0], before[0], w[0]),
        _between(turn[1], before[1], w[1]),
        _between(turn[2], before[2], w[2]),
    )
    reported = kernels.norm(rate)
    state.unturned_rate = reported if kernels.norm(turn) < _MIN_TURN_SHARE * reported else 0.0
    lowpass_twice(state.attitude, turn, rate, far, duration / _ATTITUDE_STAGE)
    add_products(state.attitude, duration)
    move, far = _velocity_of(state, p, duration), _POSITION_STEP * per_second
    speed = kernels.scaled(0.5, kernels.plus(kernels.vector(state.v_WB_W), v))
    lowpass_twice(state.position, move, speed, far, duration / _POSITION_STAGE)
    add_products(state.position, duration)


@compiled
def _between(value: float, before: float, after: float) -> float:
    """Return the value nearest to ``value`` between two rates, within the possible change."""
    mean, half = 0.5 * (before + after), min(0.5 * abs(after - before), _RATE_STEP)
    return kernels.clamp(value, mean - half, mean + half)


@compiled
def _velocity_of(state: ConsistencyState, p: kernels.Vector, duration: float) -> kernels.Vector:
    """Return the mean velocity since the previous position."""
    return kernels.scaled(1.0 / duration, kernels.minus(p, kernels.vector(state.p_WB)))


@compiled
def _compare_with_command(
    state: ConsistencyState,
    motion: tuple[kernels.Vector, kernels.Vector],
    R: kernels.Matrix,
    duration: float,
) -> None:
    """Compare velocity and rates with the command in effect since the previous odometry."""
    (v, w), times, far = motion, duration / _LOWPASS, _SPEED_STEP / duration
    lowpass(state.rates, kernels.vector(state.commanded), w, _RATE_STEP, times)
    lowpass(state.rates_late, kernels.vector(state.commanded_late), w, _RATE_STEP, times)
    gained = kernels.minus(v, kernels.vector(state.v_WB_W))
    ax, ay, az = kernels.scaled(1.0 / duration, gained)
    force, up = (ax, ay, az + state.model.gravity), kernels.column(R, 2)
    specific_thrust = _thrust_of(state, state.throttle)
    kept = math.exp(-duration / _SLOWEST_ROTORS)
    state.held_thrust = max(specific_thrust, kept * state.held_thrust)
    roll, pitch, yaw = kernels.minus(kernels.vector(state.commanded), w)
    demand = kernels.norm((roll, pitch, _YAW_DEMAND * yaw))
    state.held_demand = max(demand, kept * state.held_demand)
    thrust = kernels.scaled(specific_thrust, up)
    late_thrust = kernels.scaled(_thrust_of(state, state.late_throttle), up)
    lowpass(state.force, thrust, force, far, times)
    lowpass(state.force_late, late_thrust, force, far, times)
    lowpass(state.drag, thrust, v, math.inf, times)
    lowpass(state.drag_on_force, v, force, math.inf, times)
    for pair in (
        state.rates,
        state.rates_late,
        state.force,
        state.force_late,
        state.drag,
        state.drag_on_force,
    ):
        follow_means(pair, duration)
        add_products(pair, duration)
    carries = state.force.y[2] > _CARRYING * state.model.gravity and v[2] > _RISING_SPEED
    climbs = carries and _largest_thrust(state) < _LEAST_THRUST * state.force.y[2]
    state.climbing = state.climbing + duration if climbs else 0.0


@compiled
def _thrust_of(state: ConsistencyState, throttle: float) -> float:
    """Return the modelled thrust over the mass [m/s^2], at least 0."""
    return max(modelled_thrust(state.model, throttle), 0.0)


@compiled
def _contradicted(state: ConsistencyState, is_flying: bool) -> int:
    """Return the contradicted relations.

    The ground may prevent rotation and fall, but it does not reverse rates.
    """
    found, turn, move, gravity = 0, state.attitude, state.position, state.model.gravity
    is_unturned = state.unturned_rate > _MAX_RATE
    if is_unturned or is_contradicted(turn.yx, turn.xx, trace(turn.yy), _ATTITUDE, turn.noise):
        found |= Relation.ATTITUDE
    if is_contradicted(turn.yx.T, turn.yy, trace(turn.xx), _ATTITUDE_BACK, turn.noise):
        # Rates without rotation.
        found |= Relation.ATTITUDE
        found |= Relation.RATES
    if is_contradicted(move.yx, move.xx, trace(move.yy), _POSITION, move.noise) or is_contradicted(
        move.yx.T, move.yy, trace(move.xx), _POSITION_BACK, move.noise
    ):
        found |= Relation.POSITION
    if _rates_are_contradicted(state, _REVERSED):
        found |= Relation.RATES
        found |= Relation.REVERSED
    elif is_flying and _rates_are_contradicted(state, _RATES):
        found |= Relation.RATES
    # Saturated motors give more or less lift than commanded, hence the wide band below.
    along, squares = _horizontal(state.drag.yx), trace(_horizontal(state.drag.yy))
    on_force, drag = trace(_horizontal(state.drag_on_force.yx)), 0.0
    if squares > 0.0:
        # The drag that explains the difference best.
        drag = kernels.clamp((trace(along) - on_force) / squares, 0.0, _MOST_DRAG)
    measured = trace(_horizontal(state.force.yy)) + drag * (2.0 * on_force + drag * squares)
    if _force_is_contradicted(state.force, drag * along, measured) and _force_is_contradicted(
        state.force_late, drag * along, measured
    ):
        found |= Relation.FORCE
    # In a fast climb, drag takes part of the lift; in a tumble, late thrust has turned away.
    thrust = min(state.force.x[2], state.force_late.x[2])
    lift = state.force.y[2] + _MOST_DRAG * max(state.v_WB_W[2], 0.0)
    falls = lift < _LEAST_LIFT * thrust and lift < _FALLING * gravity
    if falls and thrust > _SOME_THRUST * gravity:
        found |= Relation.LIFT
    is_calm = state.force.y[2] > _RISING * gravity and state.held_demand < _CALM_DEMAND
    if (state.climbing > 0.0 and is_calm) or state.climbing > _LONG_CLIMB:
        found |= Relation.CLIMB
    return found


@compiled
def _largest_thrust(state: ConsistencyState) -> float:
    """Return the largest commanded thrust over the mass of the last moments [m/s^2]."""
    return float(max(state.force.x[2], state.force_late.x[2], state.held_thrust))


@compiled
def _rates_are_contradicted(state: ConsistencyState, limits: RelationLimits) -> bool:
    """Whether no plausible delay or rate loop explains the rates from the commands."""
    modelled, late = state.rates, state.rates_late
    squares = trace(modelled.yy)
    return (
        is_contradicted(modelled.yx, modelled.xx, squares, limits)
        and is_contradicted(late.yx, late.xx, squares, limits)
        and not are_explained(state.plausible)
    )


@compiled
def _force_is_contradicted(force: Pair, by_drag: Array, measured: float) -> bool:
    """Whether the horizontal force contradicts the commanded force plus drag."""
    yx, xx = _horizontal(force.yx) + by_drag, _horizontal(force.xx)
    return is_contradicted(yx, xx, measured, _FORCE)


@compiled
def _horizontal(sums: Array) -> Array:
    """Return sums of products (3, 3) with vertical parts set to 0."""
    flat = sums.copy()
    flat[2, :] = 0.0
    flat[:, 2] = 0.0
    return flat


@compiled
def _follow_tracks(
    state: ConsistencyState,
    motion: tuple[kernels.Vector, kernels.Vector, kernels.Matrix],
    duration: float,
    is_flying: bool,
    descends: bool,
) -> None:
    """Dead reckon both tracks, and periodically start a new track."""
    p, v, R = motion
    if duration <= 0.0:
        start_track(state.older, v, R)
        state.newer = state.older
        state.track_age, state.track_time = 0.0, 0.0
        return
    turn = kernels.scaled(duration, kernels.vector(state.commanded))
    forces = _thrust_of(state, state.throttle), state.model.drag, state.model.gravity
    for track in (state.older, state.newer):
        dead_reckon(track, turn, R, forces, duration, is_flying)
    state.track_age += duration
    if descends:
        return  # dead reckoning by the commands alone
    if state.track_time == 0.0:  # the first velocity that can be compared
        start_track(state.older, _smaller(_velocity_of(state, p, duration), v), R)
        state.newer = state.older
        state.track_age, state.track_time = 0.0, _TRACK_TIME
    elif state.track_age >= state.track_time:
        state.older = state.newer
        x, y = kernels.vector(state.position.x), kernels.vector(state.position.y)
        start_track(state.newer, _smaller(x, y), R)
        state.track_age = 0.0


@compiled
def _smaller(a: kernels.Vector, b: kernels.Vector) -> kernels.Vector:
    """Return the shorter of two vectors."""
    return a if kernels.dot(a, a) < kernels.dot(b, b) else b
