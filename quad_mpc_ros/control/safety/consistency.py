# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Consistency of odometry and commands: four relations, and the reaction to a contradiction.

:mod:`.comparison` compares an odometry with the previous one and the command in between,
:mod:`.contradictions` names the most likely cause.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from quad_mpc_ros.control.config import MPC, MpcConfig
from quad_mpc_ros.control.estimation.ground_detector import GroundDetector
from quad_mpc_ros.control.estimation.ground_state import AllowedCommand, GroundState
from quad_mpc_ros.control.estimation.kept_height import since
from quad_mpc_ros.control.estimation.update_mode import UpdateMode
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.parameters import parameters_of
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.model.state import Input, state_from_odometry
from quad_mpc_ros.control.safety.comparison import (
    ConsistencyState,
    Relation,
    compare_step,
    start_force,
)
from quad_mpc_ros.control.safety.contradictions import likely_cause
from quad_mpc_ros.control.safety.ladder import Action, Breach
from quad_mpc_ros.control.stage import Stage

_LONGEST_STEP_NS = 250_000_000  # between two odometries; longer gaps are not compared
_CONFIRMATIONS = 3  # successive odometries
# Much thrust over weight, for longer than motors spool up, without climb or motion.
_MUCH_THRUST, _MUCH_THRUST_NS = 2.6, 2_000_000_000
_CLIMB_SPEED, _MOVING_SPEED = 0.3, 1.0  # m/s
_FULL_THROTTLE_LIFT = 1.3  # thrust over weight that is much at full throttle
# At rest far from the reference: an estimated disturbance leaves no such error. A controller
# without integral may, but commands no turn there.
_AWAY_DISTANCE, _REST_SPEED, _AWAY_NS = 0.1, 0.1, 3_000_000_000  # m, m/s, ns
_TURN_RATE = 0.1  # rad/s


class ConsistencyMonitor(Stage):
    """Checks odometry for consistency, and with the commands, in every control step.

    A contradiction lasts until the next engagement.
    """

    def __init__(self, config: MpcConfig, ground: GroundDetector) -> None:
        """``ground`` is the ground detector of the vehicle."""
        model = parameters_of(config.vehicle(), config.lags)
        # At low frequencies a delay is equivalent to a lag of the same time.
        model["rate_time_constants"] += config.input_delay
        model["thrust_time_constant"] += config.input_delay
        self._model = model[()]
        self._ground = ground
        self._learns, self._is_mpc = config.estimate_disturbance, config.controller == MPC
        # The paper's Eq. (1) lacks the transport term, so that no rigid body agrees with it.
        self._compares = config.on_manifold
        self._hover, self._gravity = config.vehicle().hover_throttle, config.gravity
        self._engaged = True
        self._restart()
        self.reconfigure(config)

    def _restart(self) -> None:
        self._memory = ConsistencyState.zeros()
        self._memory["model"] = self._model
        self._memory["throttle"] = self._memory["late_throttle"] = self._hover
        start_force(self._memory)
        self._stamp_ns: int | None = None
        self._count = 0
        self._takes_off = False  # at the contradiction
        self._much_since_ns: int | None = None
        self._away_since_ns: int | None = None
        self._found = 0  # the contradicted relations
        self.breach: Breach | None = None
        """The contradiction, if any."""

    def reconfigure(self, config: MpcConfig) -> None:
        """Apply changed live parameters."""
        self._action = Action[config.consistency.action.upper()]
        self._full_throttle = config.throttle_max - 1e-6

    def engage(self, engaged: bool) -> None:
        """Set whether the vehicle executes commands; the comparison restarts."""
        self._engaged = engaged
        self._restart()

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Do not compare across an announced odometry jump."""
        self._stamp_ns = None

    def descent_state(self, odometry: OdometrySample) -> tuple[Array, Array | None] | None:
        """Return attitude (3, 3) and velocity (3,) for a descent, None if the motors have to idle.

        The velocity, in the world, is None if unknown.

        A take-off is aborted. With wrong rates or missing thrust the reported attitude is used. A
        vehicle that does not follow commanded rates cannot be levelled; if it turns against them,
        the motors idle. Otherwise the state is dead reckoned from the commands.
        """
        if self._takes_off:
            return None
        x, found, track = state_from_odometry(odometry), self._found, self._memory[()].older
        if found & Relation.ATTITUDE and found & Relation.RATES:
            return x.R_WB, x.v_WB_W
        if found == Relation.THRUST:
            return x.R_WB, None
        if found & Relation.REVERSED:
            return None
        if found == Relation.RATES:
            return np.eye(3), None
        if not found & (Relation.ATTITUDE | Relation.RATES | Relation.LIFT):
            return x.R_WB, track.v_attitude_W.copy()
        return track.R_WB.copy(), track.v_WB_W.copy()

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
            acted: The command in effect since the previous odometry, or None.
            p_reference: Position of the reference (3,) [m], None if unknown.
        """
        if not (self._compares and self._engaged) or acted is None:
            return self.breach
        before_ns, self._stamp_ns = self._stamp_ns, odometry.stamp_ns
        step_ns = 0 if before_ns is None else odometry.stamp_ns - before_ns
        compares = 0 < step_ns <= _LONGEST_STEP_NS
        is_flying = self._ground.learning is UpdateMode.LEARN
        used = odometry.measured
        found = compare_step(
            memory=self._memory,
            used=used,
            reported=used if reported is odometry else reported.measured,
            command=acted,
            duration=1e-9 * step_ns if compares else 0.0,
            is_flying=is_flying,
            is_on_ground=self._ground.allowed is AllowedCommand.IDLE,
            descends=self.breach is not None,
        )
        if compares and self.breach is None:
            # A vehicle that does not certainly fly may be held at rest.
            self._judge(found, odometry, acted, p_reference if is_flying else None)
        return self.breach

    def _judge(
        self, found: int, odometry: OdometrySample, acted: Input, p_reference: Array | None
    ) -> None:
        """Set the breach if a contradiction is confirmed or a symptom has lasted."""
        self._count = self._count + 1 if found else 0
        if self._count >= _CONFIRMATIONS:
            cause = likely_cause(found, self._memory[()])
            self._find(found, f"odometry and commands disagree: {cause}")
        elif self._lifts_nothing(odometry.stamp_ns, acted.throttle):
            self._find(
                Relation.THRUST,
                f"{1e-9 * _MUCH_THRUST_NS:.0f} s of thrust do not lift the vehicle: check motors, "
                "battery, mass and thrust_curve",
            )
        elif self._stays_away(odometry, acted, p_reference):
            self._find(
                Relation.RATES,
                f"odometry and commands disagree: {1e-9 * _AWAY_NS:.0f} s at rest "
                f"{_AWAY_DISTANCE} m or more from the reference: is the vehicle held, or is the "
                "odometry frozen?",
            )

    def _find(self, found: int, reason: str) -> None:
        action = self._action
        if found == Relation.CLIMB and action is Action.DESCEND:
            action = Action.STOP  # the less throttle it gets, the more it climbs
        self._found, self.breach = found, Breach(action, reason)
        self._takes_off = self._ground.state is GroundState.LIFTING_OFF

    def _lifts_nothing(self, stamp_ns: int, throttle: float) -> bool:
        """Whether high thrust has not moved the vehicle for some time."""
        vx, vy, climb = self._memory["v_WB_W"].tolist()
        is_still = climb <= _CLIMB_SPEED and math.hypot(vx, vy) <= _MOVING_SPEED
        lift = self._memory["force"]["x"][2] / self._gravity  # over the weight
        full = throttle >= self._full_throttle and lift > _FULL_THROTTLE_LIFT
        much = is_still and (full or lift > _MUCH_THRUST)
        since_ns = self._much_since_ns = since(self._much_since_ns, stamp_ns) if much else None
        return since_ns is not None and stamp_ns - since_ns >= _MUCH_THRUST_NS

    def _stays_away(
        self, odometry: OdometrySample, acted: Input, p_reference: Array | None
    ) -> bool:
        """Whether a vehicle has long been at rest away from its reference, if that is known."""
        stamp_ns = odometry.stamp_ns
        away = (
            self._learns
            and p_reference is not None
            and odometry.speed < _REST_SPEED
            and math.dist(odometry.p_WB.tolist(), p_reference.tolist()) > _AWAY_DISTANCE
            and (self._is_mpc or math.hypot(*acted.w_WB_B.tolist()) > _TURN_RATE)
        )
        since_ns = self._away_since_ns = since(self._away_since_ns, stamp_ns) if away else None
        return since_ns is not None and stamp_ns - since_ns >= _AWAY_NS


def motion_contradiction(odometries: Sequence[OdometrySample], config: MpcConfig) -> str | None:
    """Return a contradiction between odometries, else None; commands are not used."""
    ground = GroundDetector(config.gravity)
    ground.idle_wanted = True  # motors that idle explain no motion
    monitor = ConsistencyMonitor(config, ground)
    hover = Input(throttle=config.vehicle().hover_throttle, w_WB_B=np.zeros(3))
    for odometry in odometries:
        breach = monitor.check(odometry, odometry, hover)
        if breach is not None:
            return breach.reason
    return None
