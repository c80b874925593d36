# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The active source and the conditions of a handover: one state machine for all stacks.

The state machine uses neither messages nor a clock. docs/howto/stacks/README.md has the diagram.

Only a request leads out of ``RELEASED``. Every end of an engagement (request, gap in the commands,
pilot, failsafe of the stack, disarming) leads back to RELEASED, and a flight never resumes
automatically: an autopilot left in the mode for setpoints would execute any setpoint.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from quad_mpc_ros.control.estimation.ground_state import (
    LEFT_GROUND,
    LEFT_GROUND_UNPOWERED,
    NO_LIFT,
    GroundHeight,
    GroundState,
)
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.ros.bridges.config import HandoverParameters

_SECOND = 1_000_000_000
_SWITCH_TIMEOUT_NS = 5 * _SECOND  # for the stack to switch its mode
_BLOCKED_NS = 300_000_000  # shorter blockers of an offered handover are ignored
_COMMAND_GAP_NS = 100_000_000  # without a fresh command: the stack may react to a longer gap
_MAX_AGE, _MAX_REFERENCE_AGE = 0.5, 1.0  # s
_MAX_TILT, _MAX_DISTANCE, _MAX_RATE = 20.0, 1.0, 2.0  # degrees, m, rad/s: to engage and arm
_HOVER_THRUST_RATIOS = (0.5, 1.6)  # thrust over weight that roughly keeps the height


class HandoverState(enum.Enum):
    """State of the handover: which source flies the vehicle."""

    RELEASED = "released"
    """Another source. Nothing is sent to the stack."""
    OFFERED = "offered"
    """Another source; the stack is requested to switch to setpoints."""
    STANDBY = "standby"
    """None: the stack would act on setpoints but is not armed."""
    ENGAGED = "engaged"
    """The MPC."""


@dataclass(frozen=True, kw_only=True)
class Stack:
    """State of a stack; ``fault`` is the reason why nothing must be sent to it, or empty.

    ``armed`` is None while unknown. ``exit_reason`` is logged at the end of the setpoint mode.
    """

    fault: str = ""
    takes_setpoints: bool = False
    armed: bool | None = None
    exit_reason: str = "another node, a pilot or a failsafe switched the mode"


class Handover:
    """The state machine. Times are nanoseconds of the node's clock."""

    def __init__(
        self,
        parameters: HandoverParameters,
        *,
        by_pilot: bool = False,
        request: str = "call the service engage",
    ) -> None:
        """Begin released.

        Args:
            parameters: Conditions for the release.
            by_pilot: Whether a pilot may switch the mode of the stack at any time.
            request: Text that says how to engage.
        """
        self.state = HandoverState.RELEASED
        self.reason = f"not engaged: {request}"
        """Reason for the release."""
        self._request = request
        self._gap_ns = round(parameters.release_after * _SECOND)
        self._by_pilot = by_pilot
        self._offered_ns = self._command_ns = 0
        self._blocked_since_ns: int | None = None

    def offer(self, *, now_ns: int) -> None:
        """Start a handover, on request and without blockers."""
        self.state, self.reason = HandoverState.OFFERED, ""
        self._offered_ns = self._command_ns = now_ns
        self._blocked_since_ns = None

    def release(self, reason: str) -> None:
        """Release the vehicle until the next request."""
        self.state, self.reason = HandoverState.RELEASED, f"{reason}: {self._request}"

    def commanded(self, *, now_ns: int) -> None:
        """Record a fresh command."""
        self._command_ns = now_ns

    def offered_for(self, *, now_ns: int) -> int:
        """Return the time since the offer [ns]."""
        return now_ns - self._offered_ns

    def advance(self, stack: Stack, *, blocker: str, now_ns: int) -> None:
        """Update with the stack's state and the reason that blocks engaging, if any."""
        if self.state is HandoverState.RELEASED:
            return
        gap_ns = now_ns - self._command_ns
        if abs(gap_ns) > self._gap_ns:  # or the clock was set back
            self.release(f"released after {abs(gap_ns) / _SECOND:.2f} s without a fresh command")
        elif stack.fault:
            self.release(f"released because {stack.fault}")
        elif self.state is not HandoverState.OFFERED and not stack.takes_setpoints:
            gap = f"no fresh command was received for {gap_ns / _SECOND:.2f} s, and "
            reason = stack.exit_reason if gap_ns <= _COMMAND_GAP_NS else gap + stack.exit_reason
            self.release(f"released because {reason}")
        elif self.state is HandoverState.ENGAGED and not stack.armed:
            self.release("released by disarming")
        elif self.state is not HandoverState.ENGAGED:
            self._approach(stack, blocker=blocker, now_ns=now_ns)

    def _approach(self, stack: Stack, *, blocker: str, now_ns: int) -> None:
        """Follow the stack's progress, unless a blocker persists."""
        if not blocker:
            self._blocked_since_ns = None
        elif self._blocked_since_ns is None:
            self._blocked_since_ns = now_ns
        if self._blocked_since_ns is not None and now_ns - self._blocked_since_ns > _BLOCKED_NS:
            self.release(f"released because {blocker}")
        elif stack.takes_setpoints:
            self.state = HandoverState.ENGAGED if stack.armed else HandoverState.STANDBY
        elif not self._by_pilot and self.offered_for(now_ns=now_ns) > _SWITCH_TIMEOUT_NS:
            self.release("released because the stack has not switched within 5 s")


class Ground:
    """Landing state of a stack that reports only whether it is armed.

    A disarmed vehicle is on the ground. While the MPC is engaged, the MPC's ground state applies
    if it is known. Otherwise the vehicle is on the ground until its height changes.
    """

    def __init__(self) -> None:
        self.landed: bool | None = None
        """Whether the vehicle is on the ground; None while unknown."""
        self._standing_height = GroundHeight(LEFT_GROUND)

    def update(
        self, p_WB: Array, *, armed: bool, state: GroundState = GroundState.UNKNOWN
    ) -> None:
        """Update with a position (3,) [m], the arming state and the MPC's ground state."""
        height = float(p_WB[2])
        if not armed or state.is_on_ground:
            self.landed = True
            self._standing_height.set(height)
        else:
            self._standing_height.update(height)
            self.landed = self.landed is True and not (
                state.is_flying or self._standing_height.was_left
            )


class LatestStatus:
    """The newest status, valid for ``timeout`` seconds."""

    def __init__(self, *, timeout: float) -> None:
        self._timeout_ns = round(timeout * 1e9)
        self._value: Any = None
        self._received_ns = 0

    @property
    def is_empty(self) -> bool:
        """Whether no status was received."""
        return self._value is None

    def receive(self, value: Any, now_ns: int) -> None:
        """Receive a status that arrives now."""
        self._value, self._received_ns = value, now_ns

    def value(self, *, now_ns: int) -> Any:
        """Return the newest status, or None if it is missing or too old.

        If the clock was set back, the age is unknown and the status counts as too old.
        """
        return self._value if abs(now_ns - self._received_ns) <= self._timeout_ns else None


class HandoverConditions:
    """Conditions of a handover: the newest odometry, command and reference."""

    def __init__(self) -> None:
        self.odometry = LatestStatus(timeout=_MAX_AGE)
        self.command = LatestStatus(timeout=_MAX_AGE)
        """The newest command and its thrust-to-weight ratio."""
        self.reference = LatestStatus(timeout=_MAX_REFERENCE_AGE)

    def blocker(self, *, landed: bool | None, now_ns: int) -> str:
        """Return the reason that blocks engaging the MPC now, or an empty string.

        ``landed``: whether the vehicle is on the ground; None if unknown.
        """
        odometry = self.odometry.value(now_ns=now_ns)
        if odometry is None:
            return "there is no fresh odometry"
        tilt = math.degrees(math.acos(min(max(odometry.up, -1.0), 1.0)))
        if tilt > _MAX_TILT:
            return f"the vehicle tilts by {tilt:.0f}°, expected at most {_MAX_TILT:g}°"
        reference = self._reference_blocker(odometry, landed=landed, now_ns=now_ns)
        return reference or self._command_blocker(landed=landed, now_ns=now_ns)

    def _reference_blocker(
        self, odometry: OdometrySample, *, landed: bool | None, now_ns: int
    ) -> str:
        if self.reference.is_empty:
            return ""  # commands may come without a reference
        window = self.reference.value(now_ns=now_ns)
        if window is None:
            return "the reference is too old"
        away = window.pose_at(odometry.stamp_ns)[0] - odometry.p_WB
        if landed:  # ignore a reference below the ground
            rises = float(window.p_WB[:, 2].max() - odometry.p_WB[2])
            if rises > LEFT_GROUND_UNPOWERED:
                return f"the reference climbs {rises:.2f} m: the vehicle would take off at once"
            away[2] = max(away[2], 0.0)
        distance = float(np.linalg.norm(away))
        if distance <= _MAX_DISTANCE:
            return ""
        return f"the reference is {distance:.2f} m away, expected at most {_MAX_DISTANCE:g} m"

    def _command_blocker(self, *, landed: bool | None, now_ns: int) -> str:
        newest = self.command.value(now_ns=now_ns)
        if newest is None:
            return "there is no fresh command"
        command, share = newest
        least, most = _HOVER_THRUST_RATIOS
        if landed is not False:
            least = 0.0
        if landed:
            most = NO_LIFT
        if not least <= share <= most:
            return (
                f"the MPC would start with {share:.2f} of the weight as thrust, expected "
                f"{least:g} to {most:g} {'on the ground' if landed else 'in the air'}"
            )
        fastest = max(map(abs, command.w_WB_B.tolist()))
        if fastest > _MAX_RATE:
            return (
                f"the MPC would start with a body rate of {fastest:.1f} rad/s, expected at most "
                f"{_MAX_RATE:g} rad/s"
            )
        return ""


def is_old(since_ns: int | None, now_ns: int, most_ns: int) -> bool:
    """Return whether a time [ns] is unknown, or differs from now by more than ``most_ns``."""
    return since_ns is None or abs(now_ns - since_ns) > most_ns
