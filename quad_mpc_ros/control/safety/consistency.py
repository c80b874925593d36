"""Consistency of odometry and commands: four pairs of vectors that must be equal.

===========  ==================================  =======================================
relation     x                                   y
===========  ==================================  =======================================
attitude     turn of the reported attitude       reported body rates
position     change of the reported position     reported velocity, in the world
rates        commanded rates, behind their lag   reported body rates
force        commanded thrust over mass, along   change of the reported velocity, plus
             the reported attitude               gravity
===========  ==================================  =======================================

With y = M x, every M is the identity. Flipped or swapped axes, a wrong heading, wrong units, a
conjugated attitude, reversed rates or missing thrust each give another M. Both sides are
low-passed equally, which keeps M. M is estimated by least squares with the identity as prior: with
S the weighted sums of the last ``_MEMORY`` seconds,

    M = (S_yx + r I) (S_xx + r I)^-1,    r = floor^2 _MEMORY + share^2 tr(S_xx + S_ee).

The prior r outweighs motion below the floor, and motion in a direction that is a small share of
the whole or of the difference e = y - x, which a wrong mass or drag causes along the main
direction. A relation is contradicted if the smallest eigenvalue of the symmetric part of M is too
small, or if one side is rotated against the other: in the plane of axes i and j by the sine
(S_yx,ji - S_yx,ij) / (S_xx,ii + S_xx,jj + 2 r).

A controller that responds to gusts or unknown lags keeps M positive. A rate loop that rings or is
slow does not, and is no contradiction (:mod:`.plausible_loops`). Wind and a wrong mass change the
force by a constant, an offset centre of mass the rates: horizontal force and rates are taken
relative to their means of the last ``_MEMORY`` seconds (a regression with an intercept). The drag
that explains most of the difference is subtracted. The vertical force is compared directly, within
a wide band.

The difference of x and y within a sample is bounded, so that one jump counts little. Noise of a
differentiated position or attitude passes two stages of low-pass; where the bound cuts such noise
off, it does not average out, and the mean square of that part is added to that of the floor.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Matrix3, Record, RecordArray, Vector3
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.estimation.ground_detector import GroundDetector, since
from quad_mpc_ros.control.estimation.ground_state import AllowedCommand, GroundState, Learning
from quad_mpc_ros.control.estimation.kalman import inverse
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.model.actuators import first_order_lag
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.parameters import ModelParameters, modelled_thrust, parameters_of
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.model.state import Input, state_from_odometry
from quad_mpc_ros.control.safety.contradictions import likely_cause
from quad_mpc_ros.control.safety.ladder import Action, Breach
from quad_mpc_ros.control.safety.plausible_loops import (
    PlausibleRates,
    are_explained,
    follow_loops,
    start_loops,
)
from quad_mpc_ros.control.stage import Stage

_LONGEST_STEP_NS = 250_000_000  # between two odometries; longer gaps are not compared
_CONFIRMATIONS = 3  # successive odometries
_LOWPASS, _MEMORY = 0.15, 0.6  # s
_ATTITUDE_STAGE, _POSITION_STAGE = 0.04, 0.075  # s, time constants of two equal stages
_UNMODELLED_LAG = 0.1  # s, additional lag of the rates
# Yaw has the least torque: time constant of the largest yaw acceleration, and its lower bound.
_YAW_ACCELERATION_TIME, _LEAST_YAW_ACCELERATION = 2.0, 3.0  # s, rad/s^2
# Dead reckoning: time between two starts [s], and a speed that counts as 0 [m/s].
_TRACK_TIME, _SMALL_SPEED = 1.0, 0.5
# Vertical force over the commanded thrust, and margins as shares of gravity.
_LEAST_LIFT, _FALLING, _SOME_THRUST = 0.25, 0.9, 0.5
# Much thrust over weight, for longer than motors spool up, without climb or motion.
_MUCH_THRUST, _MUCH_THRUST_NS = 2.6, 2_000_000_000
_CLIMB_SPEED, _MOVING_SPEED = 0.3, 1.0  # m/s
_FULL_THROTTLE_LIFT = 1.3  # thrust over weight that is much at full throttle
# At rest far from the reference: an estimated disturbance leaves no such error.
_AWAY_DISTANCE, _REST_SPEED, _AWAY_NS = 0.1, 0.1, 3_000_000_000  # m, m/s, ns


class RelationLimits(NamedTuple):
    """Limits beyond which a relation is contradicted.

    Attributes:
        floor: Magnitude of x that counts as motion.
        share: Share of both sides and their difference that counts as motion in a direction.
        least: Smallest eigenvalue of the symmetric part of M.
        twist: Largest magnitude of the skew part of M.
    """

    floor: float
    share: float
    least: float
    twist: float


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
_NOISE_FORGETTING = 0.15  # over the forgetting of a stage of the low-pass
# Body rates above this are wrong if the attitude turns at less than this share of them.
_MAX_RATE, _MIN_TURN_SHARE = 15.0, 0.25  # rad/s


class Relation(enum.IntFlag):
    """Contradicted relations."""

    NONE = 0
    ATTITUDE = 1
    POSITION = 2
    RATES = 4
    FORCE = 8
    LIFT = 16
    REVERSED = 32  # rates
    THRUST = 64  # much thrust for long without motion


# The flags as integers, for compiled code.
_OFF_ATTITUDE, _OFF_POSITION, _OFF_RATES, _OFF_FORCE, _OFF_LIFT, _OFF_REVERSED, *_ = map(
    int, Relation
)


class Pair(Record):
    """Both low-passed sides of a relation, their means, and weighted sums of products."""

    x: Vector3
    y: Vector3
    mean_x: Vector3
    mean_y: Vector3
    xx: Matrix3
    yx: Matrix3
    yy: Matrix3


class KinematicPair(Pair):
    """The pair of a kinematic relation, low-passed by two stages."""

    first_x: Vector3  # after the first stage
    first_y: Vector3
    difference: Vector3  # y - x of the last sample
    noise: float  # mean square of the noise in x or y because of the bound on a sample


class Track(Record):
    """A state dead reckoned by the commands, and a velocity by thrust and reported attitude."""

    v_WB_W: Vector3
    R_WB: Matrix3
    v_attitude_W: Vector3  # with the thrust along the reported attitude


class ConsistencyState(Record):
    """State of the comparison."""

    p_WB: Vector3
    v_WB_W: Vector3
    R_WB: Matrix3
    w_WB_B: Vector3
    throttle: float  # behind its lag
    rates: Vector3  # commanded, behind their lag
    # The same behind an additional, unmodelled lag.
    late_throttle: float
    late_rates: Vector3
    yaw_acceleration: float  # rad/s^2, recent maximum
    unturned_rate: float  # rad/s, body rate of the last sample if the attitude hardly turned
    attitude: KinematicPair
    position: KinematicPair
    commanded: Pair  # rates
    commanded_late: Pair
    plausible: PlausibleRates  # with other rate loops
    force: Pair
    force_late: Pair
    drag: Pair  # y the velocity, x that of the force
    drag_on_force: Pair  # x the velocity, y that of the force
    older: Track
    newer: Track
    track_age: float  # s, of the newer track
    track_time: float  # s, after which a new track starts


class DescentState(NamedTuple):
    """Attitude (3, 3) and velocity (3,) for a descent, None if unknown."""

    R_WB: Array | None
    v_WB_W: Array | None


_NO_LIFT = (
    "z and thrust disagree: does z of the odometry point down (NED, expected ENU), or is a motor, "
    "a propeller or the battery missing?"
)


class FlightPhase(NamedTuple):
    """Whether the vehicle certainly flies, is on the ground, or descends after a breach."""

    is_flying: bool
    is_on_ground: bool
    descends: bool


class RestStatus(NamedTuple):
    """Whether the vehicle neither climbs nor moves, and whether it rests off its reference."""

    is_still: bool
    is_away: bool


class ConsistencyMonitor(Stage):
    """Compares odometry with itself and with the commands in every control step.

    A contradiction lasts until the next engagement.
    """

    def __init__(self, config: MpcConfig, ground: GroundDetector) -> None:
        """``ground`` is the ground detector of the vehicle."""
        model = parameters_of(config.vehicle(), config.lags)
        # At low frequencies a delay is equivalent to a lag of the same time.
        model["rate_time_constants"] += config.input_delay
        model["thrust_time_constant"] += config.input_delay
        model["thrust_time_constant_down"] += config.input_delay
        self._model = model
        self._ground = ground
        self._learns = config.estimate_disturbance
        # The paper's Eq. (1) lacks the transport term, so that no rigid body agrees with it.
        self._compares = config.on_manifold
        self._hover = config.vehicle().hover_throttle
        self._engaged = True
        self._memory = ConsistencyState.zeros()
        self.breach: Breach | None = None
        """The contradiction, if any."""
        self.found = Relation.NONE
        """The contradicted relations."""
        self._takes_off = False  # at the contradiction
        self._stamp_ns: int | None = None
        self._restart()
        self.reconfigure(config)

    def reconfigure(self, config: MpcConfig) -> None:
        """Apply changed live parameters."""
        self._action = Action[config.consistency.action.upper()]
        self._full_throttle = config.throttle_max - 1e-6

    def engage(self, engaged: bool) -> None:
        """Set whether commands act; the comparison starts again."""
        if engaged is not self._engaged:
            self._engaged = engaged
            self._restart()

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Do not compare across an announced step of the estimate."""
        self._stamp_ns = None

    def _restart(self) -> None:
        self._memory = ConsistencyState.zeros()
        self._memory["throttle"] = self._memory["late_throttle"] = self._hover
        _begin_force(self._memory, self._model)
        self._stamp_ns = None
        self._count = 0
        self._takes_off = False
        self._much_since_ns: int | None = None
        self._away_since_ns: int | None = None
        self.breach = None
        self.found = Relation.NONE

    def descent_state(self, odometry: OdometrySample) -> DescentState | None:
        """Return the state for a descent after a contradiction, None if the motors have to idle.

        A take-off is aborted. With wrong rates or missing thrust the reported attitude is used. A
        vehicle that does not follow commanded rates cannot be levelled; if it turns against them,
        the motors idle. Otherwise the state is dead reckoned by the commands.
        """
        if self._takes_off:
            return None
        wrong_rates = Relation.ATTITUDE | Relation.RATES
        if wrong_rates in self.found:
            x = state_from_odometry(odometry)
            return DescentState(x.R_WB, x.v_WB_W)
        if self.found == Relation.THRUST:
            return DescentState(state_from_odometry(odometry).R_WB, None)
        if Relation.REVERSED in self.found:
            return None
        if self.found == Relation.RATES:
            return DescentState(None, None)
        track = self._memory[()].older
        if not self.found & (Relation.ATTITUDE | Relation.RATES | Relation.LIFT):
            return DescentState(state_from_odometry(odometry).R_WB, track.v_attitude_W.copy())
        return DescentState(track.R_WB.copy(), track.v_WB_W.copy())

    def check(
        self,
        odometry: OdometrySample,
        reported: OdometrySample,
        acted: Input | None,
        *,
        p_reference: Array | None = None,
    ) -> Breach | None:
        """Compare an odometry with the previous one, and return the contradiction, if any.

        Args:
            odometry: The odometry with jumps replaced, twist in the body frame.
            reported: The odometry with jumps: its position, attitude and rates have to agree.
            acted: The command that acted since the previous odometry, None for none.
            p_reference: Position of the reference (3,) [m], None if unknown.
        """
        if self._compares and self._engaged and acted is not None:
            p_WB = odometry.p_WB
            self._compare(odometry, reported, acted, p_WB if p_reference is None else p_reference)
        return self.breach

    def _compare(
        self, odometry: OdometrySample, reported: OdometrySample, acted: Input, p_reference: Array
    ) -> None:
        before_ns, stamp_ns = self._stamp_ns, odometry.stamp_ns
        self._stamp_ns = stamp_ns
        step_ns = 0 if before_ns is None else stamp_ns - before_ns
        compares = 0 < step_ns <= _LONGEST_STEP_NS
        found, status, lift = _follow(
            memory=self._memory,
            motion=(odometry.p_WB, odometry.q_WB_xyzw, odometry.v_WB_B),
            reported=(reported.p_WB, reported.q_WB_xyzw, reported.w_WB_B),
            command=acted,
            p_reference=p_reference,
            duration=1e-9 * step_ns if compares else 0.0,
            phase=FlightPhase(
                is_flying=self._ground.learning is Learning.LEARN,
                is_on_ground=self._ground.allowed is AllowedCommand.IDLE,
                descends=self.breach is not None,
            ),
            model=self._model,
        )
        if not compares or self.breach is not None:
            return
        self._count = self._count + 1 if found else 0
        if self._count >= _CONFIRMATIONS:
            cause = self._cause(Relation(found))
            self._find(Relation(found), f"odometry and commands disagree: {cause}")
        elif self._lifts_nothing(stamp_ns, acted.throttle, is_still=status.is_still, lift=lift):
            self._find(
                Relation.THRUST,
                f"{1e-9 * _MUCH_THRUST_NS:.0f} s of thrust do not lift the vehicle: check motors, "
                "battery, mass and thrust_curve",
            )
        elif self._stays_away(stamp_ns, is_away=status.is_away):
            self._find(
                Relation.RATES,
                f"odometry and commands disagree: {1e-9 * _AWAY_NS:.0f} s at rest "
                f"{_AWAY_DISTANCE} m or more from the reference: is the vehicle held, does the "
                "odometry stand still?",
            )

    def _find(self, found: Relation, reason: str) -> None:
        self.found, self.breach = found, Breach(self._action, reason)
        self._takes_off = self._ground.state is GroundState.LIFTING_OFF

    def _cause(self, found: Relation) -> str:
        """Return the most likely cause of a contradiction."""
        state, gravity = self._memory[()], self._model[()].gravity
        if found == Relation.LIFT:
            # A reversed velocity looks like a fall.
            if _trace(state.position.yx) >= -0.5 * _trace(state.position.xx):
                return _NO_LIFT
            found |= Relation.POSITION
        pairs = {
            "attitude": state.attitude,
            "position": state.position,
            "rates": state.commanded,
            "force": state.force,
        }
        sums = {name: (pair.xx, pair.yx, pair.yy) for name, pair in pairs.items()}
        contradicted = [name for name in pairs if found & Relation[name.upper()]]
        lift = (float(state.force.x[2] / gravity), float(state.force.y[2] / gravity))
        return likely_cause(contradicted, sums, lift)

    def _lifts_nothing(
        self, stamp_ns: int, throttle: float, *, is_still: bool, lift: float
    ) -> bool:
        """Whether much thrust, ``lift`` times the weight, has not moved the vehicle for long."""
        full = throttle >= self._full_throttle and lift > _FULL_THROTTLE_LIFT
        much = is_still and (full or lift > _MUCH_THRUST)
        since_ns = self._much_since_ns = since(self._much_since_ns, stamp_ns, lasts=much)
        return since_ns is not None and stamp_ns - since_ns >= _MUCH_THRUST_NS

    def _stays_away(self, stamp_ns: int, *, is_away: bool) -> bool:
        """Whether a vehicle in flight has been at rest away from its reference for long."""
        away = is_away and self._learns
        since_ns = self._away_since_ns = since(self._away_since_ns, stamp_ns, lasts=away)
        return since_ns is not None and stamp_ns - since_ns >= _AWAY_NS


def motion_contradiction(odometries: Sequence[OdometrySample], config: MpcConfig) -> str | None:
    """Return how odometries contradict themselves, None if they do not; without commands."""
    ground = GroundDetector(config.gravity)
    ground.idle_wanted = True  # motors that idle explain no motion
    monitor = ConsistencyMonitor(config, ground)
    hover = Input(throttle=config.vehicle().hover_throttle, w_WB_B=np.zeros(3))
    for odometry in odometries:
        breach = monitor.check(odometry, odometry, hover)
        if breach is not None:
            return breach.reason
    return None


@compiled
def _follow(
    memory: RecordArray[ConsistencyState],
    motion: tuple[Array, Array, Array],
    reported: tuple[Array, Array, Array],
    command: Input,
    p_reference: Array,
    duration: float,
    phase: FlightPhase,
    model: RecordArray[ModelParameters],
) -> tuple[int, RestStatus, float]:
    """Compare an odometry with the command that acted for ``duration`` [s], nothing if it is 0.

    ``motion`` are position, attitude and velocity with jumps replaced, ``reported`` position,
    attitude and rates. ``p_reference`` (3,) is the position of the reference.

    Returns:
        Contradicted relations, rest status, and commanded vertical thrust over weight.
    """
    state, nominal = memory[()], model[()]
    p_controlled, q_WB_xyzw, v_WB_B = motion
    p_WB, q_reported_xyzw, w_WB_B = reported
    R = kernels.rotation(kernels.quaternion_in(q_WB_xyzw))
    R_reported = kernels.rotation(kernels.quaternion_in(q_reported_xyzw))
    p, w = kernels.vector(p_WB), kernels.vector(w_WB_B)
    v = kernels.apply(R, kernels.vector(v_WB_B))
    found = 0
    if duration > 0.0:
        _follow_yaw_torque(state, w[2], duration)
        _follow_command(state, nominal, command, duration)
        _compare_motion(state, p, v, R_reported, w, duration)
        if phase.is_on_ground:
            _forget(state.commanded)
            _forget(state.commanded_late)
            start_loops(state.plausible, w)
            _begin_force(memory, model)
        else:
            _compare_with_command(state, nominal, (v, w), R, duration)
            follow_loops(state.plausible, command.w_WB_B, w, duration)
        found = _contradicted(state, nominal.gravity, phase.is_flying)
        for track in (state.older, state.newer):
            _dead_reckon(track, state, nominal, R, duration)
            if not phase.is_flying:  # the ground may carry it
                track.v_WB_W[2] = max(track.v_WB_W[2], 0.0)
                track.v_attitude_W[2] = max(track.v_attitude_W[2], 0.0)
        state.track_age += duration
    if duration <= 0.0:
        kernels.store_vector(w, state.rates)
        kernels.store_vector(w, state.late_rates)
        start_loops(state.plausible, w)
        _start_track(state.older, v, R)
        state.newer = state.older
        state.track_age, state.track_time = 0.0, 0.0
    elif phase.descends:
        pass  # dead reckoning by the commands alone
    elif state.track_time == 0.0:  # the first velocity that can be compared
        _start_track(state.older, _smaller(_velocity_of(state, p, duration), v), R)
        state.newer = state.older
        state.track_age, state.track_time = 0.0, _TRACK_TIME
    elif state.track_age >= state.track_time:
        state.older = state.newer
        x, y = kernels.vector(state.position.x), kernels.vector(state.position.y)
        _start_track(state.newer, _smaller(x, y), R)
        state.track_age = 0.0
    kernels.store_vector(p, state.p_WB)
    kernels.store_vector(v, state.v_WB_W)
    kernels.store_matrix(R_reported, state.R_WB)
    kernels.store_vector(w, state.w_WB_B)
    is_still = v[2] <= _CLIMB_SPEED and math.hypot(v[0], v[1]) <= _MOVING_SPEED
    is_away = phase.is_flying and kernels.norm(v) < _REST_SPEED
    is_away &= kernels.distance(p_controlled, p_reference) > _AWAY_DISTANCE
    return found, RestStatus(is_still, is_away), state.force.x[2] / nominal.gravity


@compiled
def _follow_command(
    state: ConsistencyState, nominal: ModelParameters, command: Input, duration: float
) -> None:
    """Update throttle and rates by a command through their lags."""
    kept, _ = first_order_lag(nominal.thrust_time_constant, duration)
    state.throttle = command.throttle + kept * (state.throttle - command.throttle)
    kept, _ = first_order_lag(_UNMODELLED_LAG, duration)
    state.late_throttle = state.throttle + kept * (state.late_throttle - state.throttle)
    for k in range(3):
        kept, _ = first_order_lag(nominal.rate_time_constants[k], duration)
        rate = command.w_WB_B[k]
        state.rates[k] = rate + kept * (state.rates[k] - rate)
        kept, _ = first_order_lag(_UNMODELLED_LAG, duration)
        late = state.rates[k] + kept * (state.late_rates[k] - state.rates[k])
        if k == 2:
            most = state.yaw_acceleration * duration
            late = kernels.clamp(late, state.late_rates[k] - most, state.late_rates[k] + most)
        state.late_rates[k] = late


@compiled
def _follow_yaw_torque(state: ConsistencyState, yaw_rate: float, duration: float) -> None:
    """Update the recent maximum of the yaw acceleration by the yaw rate."""
    kept = math.exp(-duration / _YAW_ACCELERATION_TIME)
    observed = abs(yaw_rate - state.w_WB_B[2]) / duration
    remembered = max(kept * state.yaw_acceleration, observed)
    state.yaw_acceleration = max(remembered, _LEAST_YAW_ACCELERATION)


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
    _lowpass_twice(state.attitude, turn, rate, far, duration / _ATTITUDE_STAGE)
    _remember(state.attitude, duration)
    move, far = _velocity_of(state, p, duration), _POSITION_STEP * per_second
    speed = kernels.scaled(0.5, kernels.plus(kernels.vector(state.v_WB_W), v))
    _lowpass_twice(state.position, move, speed, far, duration / _POSITION_STAGE)
    _remember(state.position, duration)


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
    nominal: ModelParameters,
    motion: tuple[kernels.Vector, kernels.Vector],
    R: kernels.Matrix,
    duration: float,
) -> None:
    """Compare velocity and rates with the command that acted since the previous odometry."""
    (v, w), times, far = motion, duration / _LOWPASS, _SPEED_STEP / duration
    rates, late_rates = kernels.vector(state.rates), kernels.vector(state.late_rates)
    _lowpass(state.commanded, rates, w, _RATE_STEP, times)
    _lowpass(state.commanded_late, late_rates, w, _RATE_STEP, times)
    gained = kernels.minus(v, kernels.vector(state.v_WB_W))
    ax, ay, az = kernels.scaled(1.0 / duration, gained)
    force, up = (ax, ay, az + nominal.gravity), kernels.column(R, 2)
    thrust = kernels.scaled(max(modelled_thrust(nominal, state.throttle), 0.0), up)
    late_thrust = kernels.scaled(max(modelled_thrust(nominal, state.late_throttle), 0.0), up)
    _lowpass(state.force, thrust, force, far, times)
    _lowpass(state.force_late, late_thrust, force, far, times)
    _lowpass(state.drag, thrust, v, math.inf, times)
    _lowpass(state.drag_on_force, v, force, math.inf, times)
    for pair in (state.commanded, state.commanded_late):
        _remember_changes(pair, duration)
    for pair in (state.force, state.force_late, state.drag, state.drag_on_force):
        _remember_changes(pair, duration)


@compiled
def _lowpass(
    pair: Pair, x: kernels.Vector, y: kernels.Vector, farthest: float, times: float
) -> None:
    """Low-pass both sides over ``times`` time constants, with less weight beyond ``farthest``."""
    distance = kernels.norm(kernels.minus(y, x))
    weight = farthest / distance if distance > farthest else 1.0
    share = -math.expm1(-times)
    for k in range(3):
        pair.x[k] += share * (weight * x[k] - pair.x[k])
        pair.y[k] += share * (weight * y[k] - pair.y[k])


@compiled
def _lowpass_twice(
    pair: KinematicPair, x: kernels.Vector, y: kernels.Vector, farthest: float, times: float
) -> None:
    """Low-pass both sides by two stages of ``times`` time constants each."""
    difference = kernels.minus(y, x)
    distance = kernels.norm(difference)
    weight = farthest / distance if distance > farthest else 1.0
    turns_back = kernels.dot(difference, kernels.vector(pair.difference)) < 0.0
    cut = kernels.clamp(distance - farthest, 0.0, farthest) if turns_back else 0.0
    kernels.store_vector(difference, pair.difference)
    share = -math.expm1(-times)
    # Two stages reduce the variance of white noise to a quarter of the share of one sample.
    pair.noise += _NOISE_FORGETTING * share * (0.25 * share * cut * cut - pair.noise)
    for k in range(3):
        pair.first_x[k] += share * (weight * x[k] - pair.first_x[k])
        pair.first_y[k] += share * (weight * y[k] - pair.first_y[k])
        pair.x[k] += share * (pair.first_x[k] - pair.x[k])
        pair.y[k] += share * (pair.first_y[k] - pair.y[k])


@compiled
def _remember(pair: Pair, duration: float) -> None:
    """Add the products of both sides to the sums."""
    _add_products(pair, kernels.vector(pair.x), kernels.vector(pair.y), duration)


@compiled
def _remember_changes(pair: Pair, duration: float) -> None:
    """Add the products of both sides, relative to their means, to the sums."""
    share = -math.expm1(-duration / _MEMORY)
    for k in range(3):
        pair.mean_x[k] += share * (pair.x[k] - pair.mean_x[k])
        pair.mean_y[k] += share * (pair.y[k] - pair.mean_y[k])
    x = kernels.minus(kernels.vector(pair.x), kernels.vector(pair.mean_x))
    y = kernels.minus(kernels.vector(pair.y), kernels.vector(pair.mean_y))
    _add_products(pair, x, y, duration)


@compiled
def _add_products(pair: Pair, x: kernels.Vector, y: kernels.Vector, duration: float) -> None:
    """Add products to the decaying sums."""
    kept = math.exp(-duration / _MEMORY)
    for i in range(3):
        for j in range(3):
            pair.xx[i, j] = kept * pair.xx[i, j] + duration * x[i] * x[j]
            pair.yx[i, j] = kept * pair.yx[i, j] + duration * y[i] * x[j]
            pair.yy[i, j] = kept * pair.yy[i, j] + duration * y[i] * y[j]


@compiled
def _forget(pair: Pair) -> None:
    """Reset a relation."""
    pair.x[:], pair.y[:], pair.mean_x[:], pair.mean_y[:] = 0.0, 0.0, 0.0, 0.0
    pair.xx[:], pair.yx[:], pair.yy[:] = 0.0, 0.0, 0.0


@compiled
def _begin_force(
    memory: RecordArray[ConsistencyState], model: RecordArray[ModelParameters]
) -> None:
    """Reset the relations of the force to those of a vehicle at rest."""
    state, gravity = memory[()], model[()].gravity
    for pair in (state.force, state.force_late, state.drag, state.drag_on_force):
        _forget(pair)
    for pair in (state.force, state.force_late):
        pair.x[2] = pair.y[2] = pair.mean_x[2] = pair.mean_y[2] = gravity


@compiled
def _contradicted(state: ConsistencyState, gravity: float, is_flying: bool) -> int:
    """Return the contradicted relations.

    The ground may prevent rotation and fall, but it does not reverse rates.
    """
    found, turn, move = 0, state.attitude, state.position
    is_unturned = state.unturned_rate > _MAX_RATE
    if is_unturned or _is_contradicted(turn.yx, turn.xx, _trace(turn.yy), _ATTITUDE, turn.noise):
        found |= _OFF_ATTITUDE
    if _is_contradicted(turn.yx.T, turn.yy, _trace(turn.xx), _ATTITUDE_BACK, turn.noise):
        found |= _OFF_ATTITUDE | _OFF_RATES  # rates without rotation
    if _is_contradicted(
        move.yx, move.xx, _trace(move.yy), _POSITION, move.noise
    ) or _is_contradicted(move.yx.T, move.yy, _trace(move.xx), _POSITION_BACK, move.noise):
        found |= _OFF_POSITION
    if _rates_are_contradicted(state, _REVERSED):
        found |= _OFF_RATES | _OFF_REVERSED
    elif is_flying and _rates_are_contradicted(state, _RATES):
        found |= _OFF_RATES
    # Saturated motors give more or less lift than commanded, hence the wide band below.
    along, squares = _horizontal(state.drag.yx), _trace(_horizontal(state.drag.yy))
    on_force, drag = _trace(_horizontal(state.drag_on_force.yx)), 0.0
    if squares > 0.0:
        # The drag that explains the difference best.
        drag = kernels.clamp((_trace(along) - on_force) / squares, 0.0, _MOST_DRAG)
    measured = _trace(_horizontal(state.force.yy)) + drag * (2.0 * on_force + drag * squares)
    if _force_is_contradicted(state.force, drag * along, measured) and _force_is_contradicted(
        state.force_late, drag * along, measured
    ):
        found |= _OFF_FORCE
    # In a fast climb, drag takes part of the lift; in a tumble, late thrust has turned away.
    thrust = min(state.force.x[2], state.force_late.x[2])
    lift = state.force.y[2] + _MOST_DRAG * max(state.v_WB_W[2], 0.0)
    falls = lift < _LEAST_LIFT * thrust and lift < _FALLING * gravity
    if falls and thrust > _SOME_THRUST * gravity:
        found |= _OFF_LIFT
    return found


@compiled
def _rates_are_contradicted(state: ConsistencyState, limits: RelationLimits) -> bool:
    """Whether rates follow commands neither as modelled, nor later, nor through another loop."""
    modelled, late = state.commanded, state.commanded_late
    squares = _trace(modelled.yy)
    return (
        _is_contradicted(modelled.yx, modelled.xx, squares, limits)
        and _is_contradicted(late.yx, late.xx, squares, limits)
        and not are_explained(state.plausible)
    )


@compiled
def _force_is_contradicted(force: Pair, by_drag: Array, measured: float) -> bool:
    """Whether the horizontal force contradicts the commanded one plus drag."""
    yx, xx = _horizontal(force.yx) + by_drag, _horizontal(force.xx)
    return _is_contradicted(yx, xx, measured, _FORCE)


@compiled
def _horizontal(sums: Array) -> Array:
    """Return sums of products (3, 3) with vertical parts set to 0."""
    flat = sums.copy()
    flat[2, :] = 0.0
    flat[:, 2] = 0.0
    return flat


@compiled
def _trace(sums: Array) -> float:
    """Return the trace (sum of squares) of sums of products (3, 3)."""
    return float(sums[0, 0] + sums[1, 1] + sums[2, 2])


@compiled
def _is_contradicted(
    yx: Array, xx: Array, y_squares: float, limits: RelationLimits, noise: float = 0.0
) -> bool:
    """Whether no M near the identity satisfies y = M x.

    Args:
        yx: Weighted sums of products y x' (3, 3).
        xx: Weighted sums of products x x' (3, 3).
        y_squares: Weighted sum of the squares of y.
        limits: Limits of the relation.
        noise: Mean square of the noise in x or y.
    """
    difference = y_squares - 2.0 * _trace(yx) + _trace(xx)
    prior = (limits.floor**2 + noise) * _MEMORY + limits.share**2 * (_trace(xx) + difference)
    A, M = xx.copy(), np.zeros((3, 3))
    for k in range(3):
        A[k, k] += prior
    inverted = inverse(A)
    for i in range(3):
        for j in range(3):
            for k in range(3):
                M[i, j] += (yx[i, k] + (prior if i == k else 0.0)) * inverted[k, j]
    a, b, c = M[0, 0] - limits.least, M[1, 1] - limits.least, M[2, 2] - limits.least
    d, e, f = (
        0.5 * (M[0, 1] + M[1, 0]),
        0.5 * (M[0, 2] + M[2, 0]),
        0.5 * (M[1, 2] + M[2, 1]),
    )
    # Positive definite: all leading minors of the symmetric part less the limit are positive.
    determinant = a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)
    above = a > 0.0 and a * b - d * d > 0.0 and determinant > 0.0
    # From the sums instead of M, whose entries across the main direction are uncertain.
    twist = 0.0
    for i, j in ((0, 1), (0, 2), (1, 2)):
        turn = (yx[j, i] - yx[i, j]) / (xx[i, i] + xx[j, j] + 2.0 * prior)
        twist += turn * turn
    return not above or math.sqrt(twist) > limits.twist


@compiled
def _start_track(track: Track, v: kernels.Vector, R: kernels.Matrix) -> None:
    """Start dead reckoning at an attitude and a velocity, 0 if it is small."""
    small = kernels.dot(v, v) < _SMALL_SPEED**2
    begun = kernels.scaled(0.0 if small else 1.0, v)
    kernels.store_vector(begun, track.v_WB_W)
    kernels.store_vector(begun, track.v_attitude_W)
    kernels.store_matrix(R, track.R_WB)


@compiled
def _smaller(a: kernels.Vector, b: kernels.Vector) -> kernels.Vector:
    """Return the shorter of two vectors."""
    return a if kernels.dot(a, a) < kernels.dot(b, b) else b


@compiled
def _dead_reckon(
    track: Track,
    state: ConsistencyState,
    nominal: ModelParameters,
    R_reported: kernels.Matrix,
    duration: float,
) -> None:
    """Dead reckon a track by the commands: rotation, thrust, gravity and drag."""
    turn = kernels.scaled(duration, kernels.vector(state.rates))
    R = kernels.multiply(kernels.matrix(track.R_WB), kernels.exp(turn))
    kernels.store_matrix(R, track.R_WB)
    _accelerate(track.v_WB_W, state, nominal, kernels.column(R, 2), duration)
    _accelerate(track.v_attitude_W, state, nominal, kernels.column(R_reported, 2), duration)


@compiled
def _accelerate(
    v: Array,
    state: ConsistencyState,
    nominal: ModelParameters,
    up: kernels.Vector,
    duration: float,
) -> None:
    """Integrate a velocity (3,) with the thrust along a direction."""
    thrust = max(modelled_thrust(nominal, state.throttle), 0.0)
    for k in range(3):
        v[k] += duration * (thrust * up[k] - nominal.drag * v[k])
    v[2] -= duration * nominal.gravity
