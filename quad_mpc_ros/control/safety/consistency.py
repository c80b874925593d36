"""Consistency of odometry and commands: four pairs of vectors that physics makes equal.

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
conjugated attitude, reversed rates or missing thrust each make another M. Both sides pass the
same low-pass, which keeps M, and M is estimated by least squares over the last half second, with
the identity as prior: with S the weighted sums of the last ``_MEMORY`` seconds,

    M = (S_yx + r I) (S_xx + r I)^-1,    r = floor^2 _MEMORY.

Motion below the floor proves nothing. The relation is contradicted when the smallest eigenvalue
of the symmetric part of M is too small, or when its skew part, a rotation, is too large. A
controller that answers gusts or unknown lags keeps M positive. Wind and a wrong mass change the
force by a constant, so its horizontal part is taken relative to its mean of the last second, and
the drag that explains most of the difference is allowed for; the vertical part is compared as it
is, within a wide band.

One sample that jumps changes little: the difference of x and y within a sample is bounded.
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
from quad_mpc_ros.control.estimation.ground_detector import GroundDetector
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
from quad_mpc_ros.control.stage import Stage

_LONGEST_STEP_NS = 250_000_000  # between two odometries; across a longer gap nothing is compared
_CONFIRMATIONS = 3  # odometries in a row
_LOWPASS, _TURN_LOWPASS, _MEMORY = 0.15, 0.08, 0.6  # s
_MEAN_TIME = 1.0  # s, of the mean horizontal force
_UNMODELLED_LAG = 0.1  # s, of rates that follow their commands later than modelled
# Of dead reckoning: between two states from which it starts [s], and a speed taken for none [m/s].
_TRACK_TIME, _SMALL_SPEED = 1.0, 0.5
# Vertical force over the commanded thrust, and margins as shares of gravity.
_LEAST_LIFT, _FALLING, _SOME_THRUST = 0.25, 0.7, 0.5
# Thrust of so many weights, or full throttle, for so long without climbing; autopilots spool their
# motors up for a second and a half.
_MUCH_THRUST, _MUCH_THRUST_NS, _CLIMBING = 2.6, 2_000_000_000, 0.3  # weights, ns, m/s
_SOME_LIFT = 1.3  # weights, at full throttle


class RelationLimits(NamedTuple):
    """When a relation is contradicted.

    Attributes:
        floor: Magnitude of x that counts as motion.
        least: Smallest eigenvalue of the symmetric part of M.
        twist: Largest magnitude of the skew part of M.
    """

    floor: float
    least: float
    twist: float


# Rotations in rad/s, positions in m/s, forces in m/s^2. The second of a kinematic relation is for
# y as a function of x the other way round, which shows values that are too large.
_ATTITUDE, _ATTITUDE_BACK = RelationLimits(0.4, 0.35, 0.6), RelationLimits(1.5, 0.35, 1.0)
_POSITION, _POSITION_BACK = RelationLimits(0.5, 0.25, 0.6), RelationLimits(1.5, 0.35, 1.0)
_RATES, _REVERSED = RelationLimits(0.4, 0.1, 0.9), RelationLimits(0.4, -0.4, 0.9)
_FORCE, _MOST_DRAG = RelationLimits(1.0, -0.4, 0.69), 3.0  # 1/s
# Largest difference of the two sides within a sample: angle, distance, and as rates.
_TURN_STEP, _STEP, _RATE_STEP, _FORCE_STEP = 0.08, 0.15, 20.0, 40.0
_ABSURD = 15.0  # rad/s, of body rates and the turn of the attitude within a sample


class Relation(enum.IntFlag):
    """Relations that are contradicted."""

    NONE = 0
    ATTITUDE = 1
    POSITION = 2
    RATES = 4
    FORCE = 8
    LIFT = 16
    REVERSED = 32  # rates
    THRUST = 64  # much of it, for long


class Pair(Record):
    """Both sides of a relation, low-passed, and their weighted sums of products."""

    x: Vector3
    y: Vector3
    xx: Matrix3
    yx: Matrix3
    yy: Matrix3


class Track(Record):
    """A state that is carried on by the commands, and a velocity by thrust and attitude."""

    v_WB_W: Vector3
    R_WB: Matrix3
    v_attitude_W: Vector3  # the thrust along the attitude as reported


class Evidence(Record):
    """Everything the comparison remembers."""

    p_WB: Vector3
    v_WB_W: Vector3
    R_WB: Matrix3
    w_WB_B: Vector3
    throttle: float  # behind its lag
    rates: Vector3  # commanded, behind their lag
    # Those behind another lag, which is not modelled.
    late_throttle: float
    late_rates: Vector3
    turn_error: float  # rad/s, of the last sample
    attitude: Pair
    position: Pair
    commanded: Pair  # rates
    commanded_late: Pair
    force: Pair
    force_late: Pair
    drag: Pair  # y the velocity, low-passed as the force, which is x
    drag_on_force: float  # weighted sum of the products of velocity and measured force
    mean_x: Vector3  # of the force
    mean_x_late: Vector3
    mean_y: Vector3
    mean_v: Vector3  # of the velocity
    older: Track
    newer: Track
    track_age: float  # s, of the newer one
    track_time: float  # s, after which another one is begun


class Reckoned(NamedTuple):
    """Attitude (3, 3) and velocity (3,) to descend by, None where they are not known."""

    R_WB: Array | None
    v_WB_W: Array | None


_NO_LIFT = (
    "z and thrust disagree: does z of the odometry point down (NED, expected ENU), or is a motor, "
    "a propeller or the battery missing?"
)


class FlightPhase(NamedTuple):
    """Whether nothing but the air touches the vehicle, the ground carries it, it descends."""

    flies: bool
    stands: bool
    descends: bool


class ConsistencyMonitor(Stage):
    """Compares odometry with itself and with the commands, from control step to control step.

    A contradiction holds until commands begin to act again: nothing resumes by itself.
    """

    def __init__(self, config: MpcConfig, ground: GroundDetector) -> None:
        """``ground`` says whether the ground carries the vehicle."""
        model = parameters_of(
            config.vehicle(),
            rate_time_constant=config.rate_time_constant,
            thrust_time_constant=config.thrust_time_constant,
        )
        # A delay lags low frequencies as much as a lag of the same time.
        model["rate_time_constants"] += config.input_delay
        model["thrust_time_constant"] += config.input_delay
        self._model = model
        self._ground = ground
        # The velocity of the paper's Eq. (1) does not turn with the body: no rigid body agrees.
        self._compares = config.on_manifold
        self._hover = config.vehicle().hover_throttle
        self._engaged = True
        self._evidence = Evidence.zeros()
        self.breach: Breach | None = None
        """The contradiction found, if any."""
        self.found = Relation.NONE
        """The relations that it contradicts."""
        self._takes_off = False  # where it was found
        self._stamp_ns: int | None = None
        self._restart()
        self.reconfigure(config)

    def reconfigure(self, config: MpcConfig) -> None:
        """Take over changed live parameters."""
        self._action = Action[config.consistency.action.upper()]
        self._full_throttle = config.throttle_max - 1e-6

    def engage(self, engaged: bool) -> None:
        """Set whether commands act; when they begin to, the comparison starts again."""
        if engaged is not self._engaged:
            self._engaged = engaged
            self._restart()

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Take note of an announced step of the estimate: nothing is compared across it."""
        self._stamp_ns = None

    def _restart(self) -> None:
        self._evidence = Evidence.zeros()
        self._evidence["throttle"] = self._evidence["late_throttle"] = self._hover
        _begin_force(self._evidence, self._model)
        self._stamp_ns = None
        self._count = 0
        self._takes_off = False
        self._much_since_ns: int | None = None
        self.breach = None
        self.found = Relation.NONE

    def reckoned(self, odometry: OdometrySample) -> Reckoned | None:
        """Return by what to descend after a contradiction, None if the motors are to idle.

        A take-off ends at once. Wrong rates or a missing thrust leave the attitude as it is
        reported. A vehicle that does not follow commanded rates cannot be levelled, and one that
        turns against them is only driven further by thrust. Otherwise the commands say where they
        brought the vehicle.
        """
        if self._takes_off:
            return None
        wrong_rates = Relation.ATTITUDE | Relation.RATES
        if wrong_rates in self.found:
            x = state_from_odometry(odometry)
            return Reckoned(x.R_WB, x.v_WB_W)
        if self.found == Relation.THRUST:
            return Reckoned(state_from_odometry(odometry).R_WB, None)
        if Relation.REVERSED in self.found:
            return None
        if self.found == Relation.RATES:
            return Reckoned(None, None)
        track = self._evidence[()].older
        if not self.found & (Relation.ATTITUDE | Relation.RATES | Relation.LIFT):
            return Reckoned(state_from_odometry(odometry).R_WB, track.v_attitude_W.copy())
        return Reckoned(track.R_WB.copy(), track.v_WB_W.copy())

    def check(
        self, odometry: OdometrySample, reported: OdometrySample, acted: Input | None
    ) -> Breach | None:
        """Compare an odometry with the one before, and return the contradiction in force.

        Args:
            odometry: The vehicle as it is controlled, twist in the body frame.
            reported: The same before jumps were replaced: its position, attitude and rates have to
                agree from sample to sample.
            acted: The command that acted since the one before, None for none.
        """
        if self._compares and self._engaged and acted is not None:
            self._compare(odometry, reported, acted)
        return self.breach

    def _compare(self, odometry: OdometrySample, reported: OdometrySample, acted: Input) -> None:
        before_ns, stamp_ns = self._stamp_ns, odometry.stamp_ns
        self._stamp_ns = stamp_ns
        step_ns = 0 if before_ns is None else stamp_ns - before_ns
        compares = 0 < step_ns <= _LONGEST_STEP_NS
        found, climb, lift = _follow(
            evidence=self._evidence,
            motion=(odometry.q_WB_xyzw, odometry.v_WB_B),
            reported=(reported.p_WB, reported.q_WB_xyzw, reported.w_WB_B),
            command=acted,
            duration=1e-9 * step_ns if compares else 0.0,
            phase=FlightPhase(
                flies=self._ground.learning is Learning.LEARN,
                stands=self._ground.allowed is AllowedCommand.IDLE,
                descends=self.breach is not None,
            ),
            model=self._model,
        )
        if not compares or self.breach is not None:
            return
        self._count = self._count + 1 if found else 0
        if self._count >= _CONFIRMATIONS:
            contradicted = Relation(found)
            cause = self._cause(contradicted)
            self._find(contradicted, f"odometry and commands disagree: {cause}")
        elif self._lifts_nothing(stamp_ns, acted.throttle, climb=climb, lift=lift):
            self._find(
                Relation.THRUST,
                f"{1e-9 * _MUCH_THRUST_NS:.0f} s of thrust do not lift the vehicle: check motors, "
                "battery, mass and thrust_curve",
            )

    def _find(self, found: Relation, reason: str) -> None:
        self.found, self.breach = found, Breach(self._action, reason)
        self._takes_off = self._ground.state is GroundState.LIFTING_OFF

    def _cause(self, found: Relation) -> str:
        """Return the most likely cause of a contradiction."""
        if found == Relation.LIFT:
            return _NO_LIFT
        seen = self._evidence[()]
        pairs = {
            "attitude": seen.attitude,
            "position": seen.position,
            "rates": seen.commanded,
            "force": seen.force,
        }
        sums = {name: (pair.xx, pair.yx, pair.yy) for name, pair in pairs.items()}
        return likely_cause(sums, lift=(float(seen.force.x[2]), float(seen.force.y[2])))

    def _lifts_nothing(self, stamp_ns: int, throttle: float, *, climb: float, lift: float) -> bool:
        """Whether much thrust, to ``lift`` so many weights, has not made it climb for long."""
        full = throttle >= self._full_throttle and lift > _SOME_LIFT
        much = full or lift > _MUCH_THRUST
        if not much or climb > _CLIMBING:
            self._much_since_ns = None
        elif self._much_since_ns is None:
            self._much_since_ns = stamp_ns
        since_ns = self._much_since_ns
        return since_ns is not None and stamp_ns - since_ns >= _MUCH_THRUST_NS


def motion_contradiction(odometries: Sequence[OdometrySample], config: MpcConfig) -> str | None:
    """Return how odometries contradict themselves, None if they do not; no command is compared."""
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
    evidence: RecordArray[Evidence],
    motion: tuple[Array, Array],
    reported: tuple[Array, Array, Array],
    command: Input,
    duration: float,
    phase: FlightPhase,
    model: RecordArray[ModelParameters],
) -> tuple[int, float, float]:
    """Take an odometry and the command that acted for ``duration`` [s].

    ``motion`` are attitude and velocity as controlled, ``reported`` position, attitude and rates.
    With a duration of 0 nothing is compared.

    Returns:
        The relations that are contradicted, how fast the vehicle climbs [m/s], and how many times
        its weight the commanded thrust lifts.
    """
    seen, nominal = evidence[()], model[()]
    q_WB_xyzw, v_WB_B = motion
    p_WB, q_reported_xyzw, w_WB_B = reported
    R = kernels.rotation(kernels.quaternion_in(q_WB_xyzw))
    R_reported = kernels.rotation(kernels.quaternion_in(q_reported_xyzw))
    p, w = kernels.vector(p_WB), kernels.vector(w_WB_B)
    v = kernels.apply(R, kernels.vector(v_WB_B))
    found = 0
    if duration > 0.0:
        _follow_command(seen, nominal, command, duration)
        _compare_motion(seen, p, v, R_reported, w, duration)
        if phase.stands:
            _forget(seen.commanded)
            _forget(seen.commanded_late)
            _begin_force(evidence, model)
        else:
            _compare_with_command(seen, nominal, (v, w), R, duration)
        found = _contradicted(seen, nominal.gravity, phase.flies)
        for track in (seen.older, seen.newer):
            _carry(track, seen, nominal, R, duration)
            if not phase.flies:  # the ground may carry it
                track.v_WB_W[2] = max(track.v_WB_W[2], 0.0)
                track.v_attitude_W[2] = max(track.v_attitude_W[2], 0.0)
        seen.track_age += duration
    if duration <= 0.0:
        kernels.store_vector(w, seen.rates)
        kernels.store_vector(w, seen.late_rates)
        _anchor(seen.older, v, R)
        seen.newer = seen.older
        seen.track_age, seen.track_time = 0.0, 0.0
    elif phase.descends:
        pass  # the commands alone say where it goes
    elif seen.track_time == 0.0:  # the first velocity that can be compared
        _anchor(seen.older, _smaller(_velocity_of(seen, p, duration), v), R)
        seen.newer = seen.older
        seen.track_age, seen.track_time = 0.0, _TRACK_TIME
    elif seen.track_age >= seen.track_time:
        seen.older = seen.newer
        x, y = kernels.vector(seen.position.x), kernels.vector(seen.position.y)
        _anchor(seen.newer, _smaller(x, y), R)
        seen.track_age = 0.0
    kernels.store_vector(p, seen.p_WB)
    kernels.store_vector(v, seen.v_WB_W)
    kernels.store_matrix(R_reported, seen.R_WB)
    kernels.store_vector(w, seen.w_WB_B)
    return found, v[2], seen.force.x[2] / nominal.gravity


@compiled
def _follow_command(
    seen: Evidence, nominal: ModelParameters, command: Input, duration: float
) -> None:
    """Let throttle and rates follow a command through their lags."""
    kept, _ = first_order_lag(nominal.thrust_time_constant, duration)
    seen.throttle = command.throttle + kept * (seen.throttle - command.throttle)
    kept, _ = first_order_lag(_UNMODELLED_LAG, duration)
    seen.late_throttle = seen.throttle + kept * (seen.late_throttle - seen.throttle)
    for k in range(3):
        kept, _ = first_order_lag(nominal.rate_time_constants[k], duration)
        rate = command.w_WB_B[k]
        seen.rates[k] = rate + kept * (seen.rates[k] - rate)
        kept, _ = first_order_lag(_UNMODELLED_LAG, duration)
        seen.late_rates[k] = seen.rates[k] + kept * (seen.late_rates[k] - seen.rates[k])


@compiled
def _compare_motion(
    seen: Evidence,
    p: kernels.Vector,
    v: kernels.Vector,
    R: kernels.Matrix,
    w: kernels.Vector,
    duration: float,
) -> None:
    """Compare attitude with rates, and position with velocity, since the odometry before."""
    per_second = 1.0 / duration
    turn = kernels.log(kernels.multiply(kernels.transposed(kernels.matrix(seen.R_WB)), R))
    turn, far = kernels.scaled(per_second, turn), _TURN_STEP * per_second
    # Rates may change at once: of those between both samples the one nearest to the turn.
    before = kernels.vector(seen.w_WB_B)
    rate = (
        _between(turn[0], before[0], w[0]),
        _between(turn[1], before[1], w[1]),
        _between(turn[2], before[2], w[2]),
    )
    seen.turn_error = kernels.norm(kernels.minus(rate, turn))
    _lowpass(seen.attitude, turn, rate, far, duration / _TURN_LOWPASS)
    _remember(seen.attitude, duration)
    move, far = _velocity_of(seen, p, duration), _STEP * per_second
    speed = kernels.scaled(0.5, kernels.plus(kernels.vector(seen.v_WB_W), v))
    _lowpass(seen.position, move, speed, far, duration / _LOWPASS)
    _remember(seen.position, duration)


@compiled
def _between(value: float, before: float, after: float) -> float:
    """Return the nearest to a value between two rates, which change by no more than they can."""
    mean, half = 0.5 * (before + after), min(0.5 * abs(after - before), _RATE_STEP)
    return kernels.clamp(value, mean - half, mean + half)


@compiled
def _velocity_of(seen: Evidence, p: kernels.Vector, duration: float) -> kernels.Vector:
    """Return the mean velocity from the position before to this one."""
    return kernels.scaled(1.0 / duration, kernels.minus(p, kernels.vector(seen.p_WB)))


@compiled
def _compare_with_command(
    seen: Evidence,
    nominal: ModelParameters,
    motion: tuple[kernels.Vector, kernels.Vector],
    R: kernels.Matrix,
    duration: float,
) -> None:
    """Compare velocity and rates with the command that acted since the odometry before."""
    (v, w), times = motion, duration / _LOWPASS
    _lowpass(seen.commanded, kernels.vector(seen.rates), w, _RATE_STEP, times)
    _remember(seen.commanded, duration)
    _lowpass(seen.commanded_late, kernels.vector(seen.late_rates), w, _RATE_STEP, times)
    _remember(seen.commanded_late, duration)
    gained = kernels.minus(v, kernels.vector(seen.v_WB_W))
    ax, ay, az = kernels.scaled(1.0 / duration, gained)
    force, up = (ax, ay, az + nominal.gravity), kernels.column(R, 2)
    thrust = max(modelled_thrust(nominal, seen.throttle), 0.0)
    _lowpass(seen.force, kernels.scaled(thrust, up), force, _FORCE_STEP, times)
    thrust = max(modelled_thrust(nominal, seen.late_throttle), 0.0)
    _lowpass(seen.force_late, kernels.scaled(thrust, up), force, _FORCE_STEP, times)
    _lowpass(seen.drag, v, v, math.inf, times)
    x = _changes(kernels.vector(seen.force.x), seen.mean_x, duration)
    x_late = _changes(kernels.vector(seen.force_late.x), seen.mean_x_late, duration)
    y = _changes(kernels.vector(seen.force.y), seen.mean_y, duration)
    u = _changes(kernels.vector(seen.drag.y), seen.mean_v, duration)
    _add_products(seen.force, x, y, duration)
    _add_products(seen.force_late, x_late, y, duration)
    _add_products(seen.drag, x, u, duration)
    along = u[0] * y[0] + u[1] * y[1]
    kept = math.exp(-duration / _MEMORY)
    seen.drag_on_force = kept * seen.drag_on_force + duration * along


@compiled
def _changes(value: kernels.Vector, mean: Array, duration: float) -> kernels.Vector:
    """Return a vector relative to its mean (3,) of the last second, which follows it."""
    share = -math.expm1(-duration / _MEAN_TIME)
    for k in range(3):
        mean[k] += share * (value[k] - mean[k])
    return kernels.minus(value, kernels.vector(mean))


@compiled
def _lowpass(
    pair: Pair, x: kernels.Vector, y: kernels.Vector, farthest: float, times: float
) -> None:
    """Low-pass both sides over so many of its time constants.

    If they differ by more than ``farthest``, both count for less.
    """
    distance = kernels.norm(kernels.minus(y, x))
    weight = farthest / distance if distance > farthest else 1.0
    share = -math.expm1(-times)
    for k in range(3):
        pair.x[k] += share * (weight * x[k] - pair.x[k])
        pair.y[k] += share * (weight * y[k] - pair.y[k])


@compiled
def _remember(pair: Pair, duration: float) -> None:
    """Add the products of both sides to the sums."""
    _add_products(pair, kernels.vector(pair.x), kernels.vector(pair.y), duration)


@compiled
def _add_products(pair: Pair, x: kernels.Vector, y: kernels.Vector, duration: float) -> None:
    """Add products to the weighted sums, which forget."""
    kept = math.exp(-duration / _MEMORY)
    for i in range(3):
        for j in range(3):
            pair.xx[i, j] = kept * pair.xx[i, j] + duration * x[i] * x[j]
            pair.yx[i, j] = kept * pair.yx[i, j] + duration * y[i] * x[j]
            pair.yy[i, j] = kept * pair.yy[i, j] + duration * y[i] * y[j]


@compiled
def _forget(pair: Pair) -> None:
    """Forget all evidence of a relation."""
    pair.x[:], pair.y[:] = 0.0, 0.0
    pair.xx[:], pair.yx[:], pair.yy[:] = 0.0, 0.0, 0.0


@compiled
def _begin_force(evidence: RecordArray[Evidence], model: RecordArray[ModelParameters]) -> None:
    """Forget all evidence on the force: the vehicle is at rest."""
    seen, gravity = evidence[()], model[()].gravity
    _forget(seen.force)
    _forget(seen.force_late)
    _forget(seen.drag)
    seen.drag_on_force = 0.0
    seen.mean_x[:], seen.mean_x_late[:] = 0.0, 0.0
    seen.mean_y[:], seen.mean_v[:] = 0.0, 0.0
    seen.force.x[2] = seen.force.y[2] = seen.mean_x[2] = seen.mean_y[2] = gravity
    seen.force_late.x[2] = seen.force_late.y[2] = seen.mean_x_late[2] = gravity


@compiled
def _contradicted(seen: Evidence, gravity: float, flies: bool) -> int:
    """Return the relations that are contradicted.

    The ground may keep a vehicle from turning and from falling, but it reverses nothing.
    """
    found, turn, move = 0, seen.attitude, seen.position
    if seen.turn_error > _ABSURD or _is_contradicted(turn.yx, turn.xx, _ATTITUDE):
        found |= 1
    if _is_contradicted(turn.yx.T, turn.yy, _ATTITUDE_BACK):
        found |= 1 | 4  # rates that nothing turns by
    if _is_contradicted(move.yx, move.xx, _POSITION) or _is_contradicted(
        move.yx.T, move.yy, _POSITION_BACK
    ):
        found |= 2
    if _rates_are_contradicted(seen, _REVERSED):
        found |= 4 | 32
    elif flies and _rates_are_contradicted(seen, _RATES):
        found |= 4
    # Motors at their limits give more or less lift than asked for, hence the wide band below.
    along, square = _horizontal(seen.drag.yx), _horizontal(seen.drag.yy)
    drag = 0.0
    if square[0, 0] + square[1, 1] > 0.0:
        # The drag that explains the difference best.
        unexplained = along[0, 0] + along[1, 1] - seen.drag_on_force
        drag = kernels.clamp(unexplained / (square[0, 0] + square[1, 1]), 0.0, _MOST_DRAG)
    if _is_contradicted(
        _horizontal(seen.force.yx) + drag * along, _horizontal(seen.force.xx), _FORCE
    ) and _is_contradicted(
        _horizontal(seen.force_late.yx) + drag * along, _horizontal(seen.force_late.xx), _FORCE
    ):
        found |= 8
    # A fast climb takes as much lift as drag may be.
    thrust, lift = seen.force.x[2], seen.force.y[2] + _MOST_DRAG * max(seen.v_WB_W[2], 0.0)
    falls = lift < _LEAST_LIFT * thrust and lift < _FALLING * gravity
    if falls and thrust > _SOME_THRUST * gravity:
        found |= 16
    return found


@compiled
def _rates_are_contradicted(seen: Evidence, limits: RelationLimits) -> bool:
    """Whether rates do not follow their commands, neither as modelled nor later than that."""
    modelled, late = seen.commanded, seen.commanded_late
    return _is_contradicted(modelled.yx, modelled.xx, limits) and _is_contradicted(
        late.yx, late.xx, limits
    )


@compiled
def _horizontal(sums: Array) -> Array:
    """Return sums of products (3, 3) without their vertical parts."""
    flat = sums.copy()
    flat[2, :] = 0.0
    flat[:, 2] = 0.0
    return flat


@compiled
def _is_contradicted(yx: Array, xx: Array, limits: RelationLimits) -> bool:
    """Whether y = M x does not hold with an M near the identity, by sums of products (3, 3)."""
    prior = limits.floor**2 * _MEMORY
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
    # All leading minors of the symmetric part less the limit are positive.
    determinant = a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)
    above = a > 0.0 and a * b - d * d > 0.0 and determinant > 0.0
    skew = math.sqrt((M[0, 1] - d) ** 2 + (M[0, 2] - e) ** 2 + (M[1, 2] - f) ** 2)
    return not above or skew > limits.twist


@compiled
def _anchor(track: Track, v: kernels.Vector, R: kernels.Matrix) -> None:
    """Begin dead reckoning at a velocity, none if it is small, and an attitude."""
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
def _carry(
    track: Track,
    seen: Evidence,
    nominal: ModelParameters,
    R_reported: kernels.Matrix,
    duration: float,
) -> None:
    """Carry a track on by the commands: turn, thrust, gravity and drag."""
    turn = kernels.scaled(duration, kernels.vector(seen.rates))
    R = kernels.multiply(kernels.matrix(track.R_WB), kernels.exp(turn))
    kernels.store_matrix(R, track.R_WB)
    _accelerate(track.v_WB_W, seen, nominal, kernels.column(R, 2), duration)
    _accelerate(track.v_attitude_W, seen, nominal, kernels.column(R_reported, 2), duration)


@compiled
def _accelerate(
    v: Array, seen: Evidence, nominal: ModelParameters, up: kernels.Vector, duration: float
) -> None:
    """Carry a velocity (3,) on with the thrust along a direction."""
    thrust = max(modelled_thrust(nominal, seen.throttle), 0.0)
    for k in range(3):
        v[k] += duration * (thrust * up[k] - nominal.drag * v[k])
    v[2] -= duration * nominal.gravity
