# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The delay of the vehicle behind the reference, and the delayed reference.

The publisher of the reference does not know the delay: windows begin at the current time. Samples
are kept until the vehicle has passed them, so that it flies the whole path with delay. A jump of
the reference ends the delay.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import ReferenceWindow
from quad_mpc_ros.control.ocp.plan import Plan
from quad_mpc_ros.control.stage import Stage

_JUMP_DISTANCE = 0.2  # m, between successive windows at the same time: a jump of the reference
_ARRIVAL_DISTANCE = 0.01  # m, to a reference at rest that ends the delay
_MAX_AHEAD, _MAX_BEHIND = 0.2, 10.0  # s, lead over the reference's clock, and delay behind it

_SAMPLES = ("p_WB", "q_WB_xyzw", "v_WB_W", "a_WB_W", "w_WB_W")


class _Flown(NamedTuple):
    """A plan, the stamp of its odometry, and the time until which its delay was counted."""

    plan: Plan
    stamp_ns: int
    counted_ns: int


class DelayedReference(Stage):
    """The reference delayed by ``behind`` seconds."""

    def __init__(self) -> None:
        self._engaged = True
        self.reset()

    def reset(self) -> None:
        """Reset the delay to zero."""
        self.behind = 0.0
        self._reference: ReferenceWindow | None = None
        self._flown: _Flown | None = None

    def engage(self, engaged: bool) -> None:
        """Reset the delay; only an engaged vehicle is behind."""
        self._engaged = engaged
        self.reset()

    def take(self, plan: Plan, *, stamp_ns: int) -> None:
        """Take the plan for the odometry of a stamp; the plan's speeds determine the delay."""
        if self._engaged:
            self._flown = _Flown(plan, stamp_ns, stamp_ns)

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Transform the kept reference by an announced odometry jump."""
        if self._reference is not None:
            self._reference = reset.window(self._reference)

    def at(self, window: ReferenceWindow, stamp_ns: int) -> ReferenceWindow:
        """Return the delayed reference from a stamp on; ``window`` is the newest window."""
        if self._flown is None:
            self._reference = window
            return window
        self._count(stamp_ns)
        reference = self._extended(window)
        if self.behind == 0.0 or _is_over(reference, window, self.behind):
            self.behind = 0.0
            self._reference = window
            return window
        behind_ns = round(1e9 * self.behind)
        ahead = int(reference.offset_ns.searchsorted(min(-behind_ns, 0), side="right"))
        first = max(ahead - 1, 0)
        self._reference = reference = _from(reference, first)
        return dataclasses.replace(reference, offset_ns=reference.offset_ns + behind_ns)

    def _count(self, stamp_ns: int) -> None:
        """Update the delay with the plan's speeds since the last call."""
        assert self._flown is not None
        plan, began_ns, counted_ns = self._flown
        since, until = 1e-9 * (counted_ns - began_ns), 1e-9 * (stamp_ns - began_ns)
        behind = self.behind + plan.given_up(since, until)
        self.behind = min(max(behind, -_MAX_AHEAD), _MAX_BEHIND)
        self._flown = self._flown._replace(counted_ns=stamp_ns)

    def _extended(self, window: ReferenceWindow) -> ReferenceWindow:
        """Return the kept samples before the window, followed by the window."""
        reference = self._reference
        if reference is None or reference is window:
            return window
        begins_ns = int(window.offset_ns[0])
        offsets_ns = reference.offset_ns + (reference.stamp_ns - window.stamp_ns)
        is_unrelated = reference.frame_id != window.frame_id or offsets_ns[-1] < begins_ns
        if is_unrelated or _has_jumped(reference, window):
            self.behind = 0.0
            return window
        kept = int(offsets_ns.searchsorted(begins_ns, side="left"))
        joined: dict[str, Any] = {
            name: np.concatenate((getattr(reference, name)[:kept], getattr(window, name)))
            for name in _SAMPLES
        }
        return dataclasses.replace(
            window, offset_ns=np.concatenate((offsets_ns[:kept], window.offset_ns)), **joined
        )


def _from(window: ReferenceWindow, first: int) -> ReferenceWindow:
    """Return a window from a sample on."""
    kept: dict[str, Any] = {name: getattr(window, name)[first:] for name in _SAMPLES}
    return dataclasses.replace(window, offset_ns=window.offset_ns[first:], **kept)


def _has_jumped(reference: ReferenceWindow, window: ReferenceWindow) -> bool:
    """Whether a window differs from the previous reference at equal times."""
    both_ns = max(each.stamp_ns + int(each.offset_ns[0]) for each in (reference, window))
    (p_before, _), (p_after, _) = reference.pose_at(both_ns), window.pose_at(both_ns)
    return float(np.linalg.norm(p_after - p_before)) > _JUMP_DISTANCE


def _is_over(reference: ReferenceWindow, window: ReferenceWindow, behind: float) -> bool:
    """Whether the reference has been at rest for ``behind`` seconds."""
    if window.v_WB_W[0].any() or window.a_WB_W[0].any():
        return False
    p_W, _ = reference.pose_at(window.stamp_ns - round(1e9 * behind))
    return float(np.linalg.norm(window.p_WB[0] - p_W)) < _ARRIVAL_DISTANCE
