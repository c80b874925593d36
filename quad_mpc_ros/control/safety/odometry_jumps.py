# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Unannounced jumps of the odometry: attitude, velocity or position that other fields contradict.

Between two odometries the attitude should change by the mean body rates, the velocity by possible
accelerations, and the position by the mean velocity. A difference beyond

    s + 4 e + m + d t

is a jump and is rejected. s is the largest tolerated jump, e the RMS of the previous differences
(the noise), m the motion possible between the two odometries, d the drift of an integrated
velocity and t the time for which positions have been rejected. Only the quantity that jumped is
replaced: the attitude by the integrated rates, the velocity by the velocity without its jump, the
position by the integrated velocity.

A jump ends when the quantity returns. A jump of position or heading is accepted after three
seconds, as estimators correct themselves. For 30 s after that, a jump back is accepted at once,
and another jump after nine seconds, so that an estimate that jumps back and forth is not tracked.
A velocity jump is accepted as soon as the positions agree with the new velocity. A jump of roll or
pitch is never accepted, because a hovering vehicle cannot change its tilt.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Matrix3, Record, RecordArray, Vector3
from quad_mpc_ros.control.lie import Array, kernels, so3
from quad_mpc_ros.control.lie.kernels import Vector
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import Measured, OdometrySample
from quad_mpc_ros.control.stage import Stage, StageLog

_NOISE_FACTOR = 4.0
_POSITION_ACCELERATION = 20.0  # m/s^2, largest expected between positions
_VELOCITY_ACCELERATION = 40.0  # m/s^2, largest expected between velocities
_ANGULAR_ACCELERATION = 200.0  # rad/s^2
_DRIFT = 0.2  # m/s, of the integrated velocity
# Time after which a jump is accepted [s], factor for another jump within the last time [s].
_ACCEPT_AFTER, _REPEAT_FACTOR, _REPEAT_TIME = 3.0, 3.0, 30.0
# Estimation of the noise: initial time in which everything is accepted, and time constant.
_LEARNING_TIME, _NOISE_TIME = 1.0, 2.0  # s
_COMPARISON_TIME = 0.2  # s, over which positions are compared with two velocities
# Attitude, velocity and position: largest tolerated jump, and largest difference of the noise.
_SMALL_TURN, _MOST_TURN = 0.2, 0.2  # rad
_SMALL_CHANGE, _MOST_CHANGE = 2.0, 3.0  # m/s
_SMALL_STEP, _MOST_STEP = 0.75, 3.0  # m

# Outcomes: used, rejected by a new or a known jump, used again because it is back or has lasted.
_USED, _JUMPED, _REJECTED, _BACK, _LASTED = range(5)
_ALL_USED = (_USED, _USED, _USED)


class Tracked(Record):
    """The odometry in use, and the reported position."""

    p_WB: Vector3
    R_WB: Matrix3
    v_WB_W: Vector3
    w_WB_B: Vector3
    reported_W: Vector3


class Jumps(Record):
    """Jumps of a quantity; the offset of an attitude is a rotation vector in the world."""

    is_attitude: int

    rejected: int  # whether a jump by ``offset`` is rejected since ``since_ns``
    rejected_ns: int  # since when any jump has been rejected
    since_ns: int
    offset: Vector3
    accepted: int  # whether a jump was accepted, the last one at ``accepted_ns``
    accepted_ns: int
    returns: int  # whether ``back``, the jump back, is accepted at once
    back: Vector3
    count: int  # of the differences
    square: float  # mean square of the differences
    size: float  # of the last jump, for the log
    lasted: float  # s, duration of the last jump, for the log


class PositionErrors(Record):
    """Errors [m] of the reported positions against the integrals of two velocities."""

    first_W: Vector3
    second_W: Vector3


class Tracking(Record):
    """State of the detection."""

    now: Tracked
    before: Tracked
    attitude: Jumps
    velocity: Jumps
    position: Jumps
    of_attitude: PositionErrors  # of the velocity constant in the world, or in the body
    of_velocity: PositionErrors  # of the velocity without its jump, or with it
    turn: float  # rad, last accepted jump of the heading


# Unit of a jump, and why the quantity is replaced; the gravest quantity first.
_QUANTITIES = {
    "position": (
        "{:.1f} m",
        "which neither velocity nor odom_reset explains: the velocity is integrated instead",
    ),
    "attitude": (
        "{:.0f} degrees",
        "which neither body rates nor odom_reset explain: body rates are integrated instead",
    ),
    "velocity": (
        "{:.1f} m/s",
        "which the positions do not confirm: the jump is subtracted",
    ),
}


class OdometryJumps(Stage):
    """Replaces quantities that jumped, in odometries with the twist in the body frame."""

    def __init__(self, log: StageLog) -> None:
        self._log = log
        self.resets: list[EstimateReset] = []
        """Accepted jumps of the heading, which the controller takes.

        The vehicle did not turn, so vectors in the world are rotated instead.
        """
        self._engaged = True
        self._begin()

    def _begin(self) -> None:
        self._tracking = Tracking.zeros()
        self._tracking["attitude"]["is_attitude"] = 1
        self._stamp_ns: int | None = None
        self._used: OdometrySample | None = None
        self._began_ns = 0
        self._faults = dict.fromkeys(_QUANTITIES, "")
        self.fault = ""
        """The reason for changing the last odometry, else empty."""

    def engage(self, engaged: bool) -> None:
        """Set whether the vehicle executes commands; if not, odometry is used unchanged."""
        self._engaged = engaged

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Transform the tracked odometry by an announced odometry jump."""
        quantities = [self._tracking[name] for name in _QUANTITIES]
        rejects = any(jumps["rejected"] for jumps in quantities)
        if self._stamp_ns is None or not (rejects or self._stamp_ns < reset.stamp_ns):
            return  # the odometry in the new frame has already arrived
        now = self._tracking["now"]
        for position in (now["p_WB"], now["reported_W"]):
            position[:] = reset.points(position)
        now["v_WB_W"][:] = reset.vectors(now["v_WB_W"])
        now["R_WB"][:] = reset.vectors(now["R_WB"].T).T
        for jumps in quantities:
            jumps["rejected"] = jumps["returns"] = False

    def checked(self, odometry: OdometrySample) -> OdometrySample:
        """Return the odometry with jumps replaced; ``fault`` is the reason."""
        before_ns, stamp_ns = self._stamp_ns, odometry.stamp_ns
        if before_ns == stamp_ns:
            return self._used or odometry  # sent again
        if before_ns is None or stamp_ns < before_ns or not self._engaged:
            self._begin()
            before_ns = self._began_ns = stamp_ns
        self._stamp_ns, self._used, self.fault = stamp_ns, None, ""
        outcomes = _check_step(
            buffer=self._tracking,
            measured=odometry.measured,
            stamps_ns=(before_ns, stamp_ns),
            learning=1e-9 * (stamp_ns - self._began_ns) < _LEARNING_TIME,
        )
        if outcomes == _ALL_USED:
            return odometry
        self._report(outcomes)
        _, attitude, _ = outcomes
        if attitude in (_BACK, _LASTED):
            self._accept_heading(odometry)
        if self.fault:
            self._used = self._replaced(odometry)
        return self._used or odometry

    def _report(self, outcomes: tuple[int, int, int]) -> None:
        """Set the faults, and log the accepted jumps."""
        for name, outcome in zip(_QUANTITIES, outcomes, strict=True):
            jumps, (unit, contradicted) = self._tracking[name], _QUANTITIES[name]
            size, lasted = float(jumps["size"]), float(jumps["lasted"])
            text = unit.format(math.degrees(size) if name == "attitude" else size)
            if outcome == _JUMPED:
                self._faults[name] = f"{name} jumped by {text}, {contradicted}"
            elif outcome != _REJECTED:
                self._faults[name] = ""
            if outcome == _BACK:
                self._log.warn(f"{name} jumped back by {text}: accepted")
            elif outcome == _LASTED:
                self._log.warn(f"{name} jump of {text} has lasted for {lasted:.1f} s: accepted")
        self.fault = next(filter(None, self._faults.values()), "")

    def _accept_heading(self, odometry: OdometrySample) -> None:
        turn, stamp_ns = float(self._tracking["turn"]), odometry.stamp_ns
        about = EstimateReset(stamp_ns=stamp_ns, turn=turn, step_W=np.zeros(3))
        step_W = odometry.p_WB - about.points(odometry.p_WB)
        self.resets.append(dataclasses.replace(about, step_W=step_W, frame_id=odometry.frame_id))

    def _replaced(self, odometry: OdometrySample) -> OdometrySample:
        """Return the odometry with position, attitude and velocity in use."""
        now = self._tracking["now"].copy()
        return dataclasses.replace(
            odometry,
            p_WB=now["p_WB"],
            q_WB_xyzw=so3.quaternion_xyzw_from_rotation(now["R_WB"]),
            v_WB_B=now["R_WB"].T @ now["v_WB_W"],
        )


class Step(NamedTuple):
    """Step of ``duration`` [s] to the next odometry; ``learning`` rejects nothing."""

    stamp_ns: int
    duration: float
    learning: bool


@compiled
def _check_step(
    buffer: RecordArray[Tracking],
    measured: Measured,
    stamps_ns: tuple[int, int],
    learning: bool,
) -> tuple[int, int, int]:
    """Track an odometry, and return the outcomes for position, attitude and velocity.

    For the first odometry both stamps are equal.
    """
    tracking, (before_ns, stamp_ns) = buffer[()], stamps_ns
    p_WB, q_WB_xyzw, v_WB_B, w_WB_B = measured
    tracking.before = tracking.now
    now = tracking.now
    kernels.store_vector(kernels.vector(p_WB), now.p_WB)
    kernels.store_vector(kernels.vector(p_WB), now.reported_W)
    kernels.store_vector(kernels.vector(w_WB_B), now.w_WB_B)
    kernels.store_matrix(kernels.rotation(kernels.quaternion_in(q_WB_xyzw)), now.R_WB)
    kernels.store_vector(kernels.in_world(q_WB_xyzw, v_WB_B), now.v_WB_W)
    if before_ns == stamp_ns:
        return _ALL_USED
    step = Step(stamp_ns, 1e-9 * (stamp_ns - before_ns), learning)
    attitude = _check_attitude(tracking, kernels.vector(v_WB_B), step)
    velocity = _check_velocity(tracking, step)
    return _check_position(tracking, step), attitude, velocity


@compiled
def _check_attitude(tracking: Tracking, v_WB_B: Vector, step: Step) -> int:
    """Check the attitude, and replace a jumped value."""
    before, now, jumps = tracking.before, tracking.now, tracking.attitude
    w_before, w_now = kernels.vector(before.w_WB_B), kernels.vector(now.w_WB_B)
    # Rates without lag may change abruptly, at any time of the step.
    changed = 0.5 * kernels.distance(before.w_WB_B, now.w_WB_B)
    turn = kernels.exp(kernels.scaled(0.5 * step.duration, kernels.plus(w_before, w_now)))
    expected = kernels.multiply(kernels.matrix(before.R_WB), turn)
    R_WB, was_rejected = kernels.matrix(now.R_WB), jumps.rejected
    off = kernels.multiply(R_WB, kernels.transposed(expected))
    tilts = math.acos(kernels.clamp(off[8], -1.0, 1.0)) > _SMALL_TURN
    motion = (0.5 * _ANGULAR_ACCELERATION * step.duration + changed) * step.duration
    outcome = _outcome_of(
        jumps,
        kernels.log(off),
        possible=_SMALL_TURN + motion,
        drift=0.0,
        most=_MOST_TURN,
        lasting=math.inf if tilts else _ACCEPT_AFTER,
        step=step,
    )
    if not jumps.rejected:
        tracking.turn = math.atan2(off[3] - off[1], off[0] + off[4])
        return outcome
    back = kernels.exp(kernels.scaled(-1.0, kernels.vector(jumps.offset)))
    R_WB = kernels.multiply(back, R_WB)
    kernels.store_matrix(R_WB, now.R_WB)
    # The velocity was measured in the body, or in the world and rotated by the attitude.
    v_before, in_world_W = kernels.vector(before.v_WB_W), kernels.vector(now.v_WB_W)
    in_body_W, errors = kernels.apply(R_WB, v_WB_B), tracking.of_attitude
    if not was_rejected:
        # Start with the errors of a constant difference.
        for k in range(3):
            errors.first_W[k] = _COMPARISON_TIME * (v_before[k] - in_world_W[k])
            errors.second_W[k] = _COMPARISON_TIME * (v_before[k] - in_body_W[k])
    if _prefers_second(errors, tracking, in_world_W, in_body_W, step.duration):
        kernels.store_vector(in_body_W, now.v_WB_W)
    return outcome


@compiled
def _check_velocity(tracking: Tracking, step: Step) -> int:
    """Check the velocity, and replace a jumped value."""
    now, jumps, errors = tracking.now, tracking.velocity, tracking.of_velocity
    v_WB_W, agrees = kernels.vector(now.v_WB_W), False
    if jumps.rejected:
        without_W = kernels.minus(v_WB_W, kernels.vector(jumps.offset))
        agrees = _prefers_second(errors, tracking, without_W, v_WB_W, step.duration)
    else:
        errors.first_W[:], errors.second_W[:] = 0.0, 0.0
    change_W = kernels.minus(v_WB_W, kernels.vector(tracking.before.v_WB_W))
    outcome = _outcome_of(
        jumps,
        change_W,
        possible=_SMALL_CHANGE + _VELOCITY_ACCELERATION * step.duration,
        drift=0.0,
        most=_MOST_CHANGE,
        lasting=_COMPARISON_TIME if agrees else math.inf,
        step=step,
    )
    if jumps.rejected:
        v_WB_W = kernels.minus(v_WB_W, kernels.vector(jumps.offset))
        kernels.store_vector(v_WB_W, now.v_WB_W)
    return outcome


@compiled
def _check_position(tracking: Tracking, step: Step) -> int:
    """Check the position, and replace a jumped value."""
    before, now, jumps = tracking.before, tracking.now, tracking.position
    v_WB_W, duration = kernels.vector(now.v_WB_W), step.duration
    twice_W = kernels.plus(kernels.vector(before.v_WB_W), v_WB_W)
    moved_W = kernels.scaled(0.5 * duration, twice_W)
    expected_W = kernels.plus(kernels.vector(before.p_WB), moved_W)
    off_W = kernels.minus(kernels.vector(now.p_WB), expected_W)
    motion = (kernels.norm(v_WB_W) + 0.5 * _POSITION_ACCELERATION * duration) * duration
    outcome = _outcome_of(
        jumps,
        off_W,
        possible=_SMALL_STEP + motion,
        drift=_DRIFT,
        most=_MOST_STEP,
        lasting=_ACCEPT_AFTER,
        step=step,
    )
    if jumps.rejected:
        kernels.store_vector(expected_W, now.p_WB)
    return outcome


@compiled
def _outcome_of(
    jumps: Jumps,
    offset: Vector,
    possible: float,
    drift: float,
    most: float,
    lasting: float,
    step: Step,
) -> int:
    """Take the ``offset`` of a value from the expected one; return the outcome.

    ``possible`` is s + m, ``most`` bounds the noise. A jump is accepted after ``lasting`` [s].
    """
    size, stamp_ns = kernels.norm(offset), step.stamp_ns
    rejected = 1e-9 * (stamp_ns - jumps.rejected_ns) if jumps.rejected else 0.0
    tolerance = possible + _NOISE_FACTOR * math.sqrt(jumps.square) + drift * rejected
    if size <= tolerance or step.learning:
        jumps.count += 1
        share = max(1.0 / jumps.count, min(step.duration / _NOISE_TIME, 0.2))
        noise = min(size, most)
        jumps.square += share * (noise * noise - jumps.square)
        jumps.rejected = 0
        return _USED
    jumps.size = size
    since_accepted = 1e-9 * (stamp_ns - jumps.accepted_ns)
    recent = jumps.accepted and since_accepted < _REPEAT_TIME
    from_back = _distance(jumps, offset, jumps.back)
    if recent and jumps.returns and from_back <= tolerance + drift * since_accepted:
        _accept(jumps, stamp_ns)
        return _BACK
    outcome = _REJECTED
    if not jumps.rejected:
        jumps.rejected_ns = stamp_ns
    if not jumps.rejected or _distance(jumps, offset, jumps.offset) > tolerance:
        outcome = _JUMPED
        jumps.rejected, jumps.since_ns = 1, stamp_ns
        kernels.store_vector(offset, jumps.offset)
    jumps.lasted = 1e-9 * (stamp_ns - jumps.since_ns)
    if jumps.lasted < (_REPEAT_FACTOR * lasting if recent else lasting):
        return outcome
    _accept(jumps, stamp_ns)
    jumps.returns = 1
    kernels.store_vector(kernels.scaled(-1.0, offset), jumps.back)
    return _LASTED


@compiled
def _accept(jumps: Jumps, stamp_ns: int) -> None:
    jumps.rejected, jumps.returns, jumps.accepted, jumps.accepted_ns = 0, 0, 1, stamp_ns


@compiled
def _prefers_second(
    errors: PositionErrors, tracking: Tracking, first_W: Vector, second_W: Vector, duration: float
) -> bool:
    """Whether the second of two velocities agrees better with the reported positions."""
    now, before = tracking.now, tracking.before
    kept = math.exp(-duration / _COMPARISON_TIME)
    for k in range(3):
        moved = now.reported_W[k] - before.reported_W[k]
        errors.first_W[k] = kept * errors.first_W[k] + moved - duration * first_W[k]
        errors.second_W[k] = kept * errors.second_W[k] + moved - duration * second_W[k]
    return kernels.length(errors.second_W) < kernels.length(errors.first_W)


@compiled
def _distance(jumps: Jumps, offset: Vector, other: Array) -> float:
    """Return the distance of two offsets; of attitudes the angle between them."""
    if not jumps.is_attitude:
        return kernels.norm(kernels.minus(offset, kernels.vector(other)))
    back = kernels.exp(kernels.scaled(-1.0, kernels.vector(other)))
    return kernels.norm(kernels.log(kernels.multiply(kernels.exp(offset), back)))
