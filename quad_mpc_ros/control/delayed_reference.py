"""How far the vehicle is behind the reference's clock, and the reference as late as that.

Who publishes the reference knows nothing of it: windows begin now, whatever the vehicle can
follow. What they said is kept for as long as it is ahead of the vehicle, so that it flies all of
the way, later. A new reference joins the way where it begins, the present.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import ReferenceWindow
from quad_mpc_ros.control.ocp.plan import Plan
from quad_mpc_ros.control.stage import Stage

# m: a reference further than this from where it was to be by now has jumped.
_JUMP = 0.2
# m: at rest and as near as this it is where the vehicle is to be.
_THERE = 0.01
# s: how far ahead of the clock, which the windows have to reach beyond.
_AHEAD_MAX = 0.2

_SAMPLES = ("p_WB", "q_WB_xyzw", "v_WB_W", "a_WB_W", "w_WB_W")


class _Flown(NamedTuple):
    """A plan, the stamp of the odometry that it answers, and until when it has been counted."""

    plan: Plan
    stamp_ns: int
    counted_ns: int


class DelayedReference(Stage):
    """The reference as it was ``behind`` seconds ago, and what follows on it."""

    def __init__(self, config: MpcConfig) -> None:
        self._engaged = True
        self._reset()
        self.reconfigure(config)

    def _reset(self) -> None:
        self.behind = 0.0
        self._way: ReferenceWindow | None = None
        self._flown: _Flown | None = None

    def reconfigure(self, config: MpcConfig) -> None:
        """Apply a changed ``behind_max``, the most that it may be behind [s]."""
        self._config = config
        self._behind_max = config.contouring.behind_max

    def renewed(self) -> DelayedReference:
        """Return one like this that knows the engagement and nothing else."""
        fresh = DelayedReference(self._config)
        fresh.engage(self._engaged)
        return fresh

    def engage(self, engaged: bool) -> None:
        """Begin at the reference's clock: only a vehicle that acts on commands is behind it."""
        self._engaged = engaged
        self._reset()

    def take(self, plan: Plan, *, stamp_ns: int) -> None:
        """Take the plan that answers the odometry of a stamp: by its speeds time is given up."""
        if self._engaged and plan.speeds.size > 0:
            self._flown = _Flown(plan, stamp_ns, stamp_ns)

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Take an announced step of the estimate: the way moves along."""
        if self._way is not None:
            self._way = reset.window(self._way)

    def at(self, window: ReferenceWindow, stamp_ns: int) -> ReferenceWindow:
        """Return what to follow from the stamp of an odometry on, given the newest window."""
        if self._flown is None:
            self._way = window
            return window
        self._count(stamp_ns)
        way = self._extended(window)
        if self.behind == 0.0 or _is_over(way, window, self.behind):
            self.behind = 0.0
            self._way = window
            return window
        behind_ns = round(1e9 * self.behind)
        ahead = int(way.offset_ns.searchsorted(min(-behind_ns, 0), side="right"))
        first = max(ahead - 1, 0)
        self._way = way = _from(way, first)
        return dataclasses.replace(way, offset_ns=way.offset_ns + behind_ns)

    def _count(self, stamp_ns: int) -> None:
        """Add what has been given up since the last time."""
        assert self._flown is not None
        plan, began_ns, counted_ns = self._flown
        since, until = 1e-9 * (counted_ns - began_ns), 1e-9 * (stamp_ns - began_ns)
        behind = self.behind + plan.given_up(since, until)
        self.behind = min(max(behind, -_AHEAD_MAX), self._behind_max)
        self._flown = self._flown._replace(counted_ns=stamp_ns)

    def _extended(self, window: ReferenceWindow) -> ReferenceWindow:
        """Return what was ahead before the window begins, and the window."""
        way = self._way
        if way is None or way is window:
            return window
        begins_ns = int(window.offset_ns[0])
        offsets_ns = way.offset_ns + (way.stamp_ns - window.stamp_ns)
        is_elsewhere = way.frame_id != window.frame_id or offsets_ns[-1] < begins_ns
        if is_elsewhere or _has_jumped(way, window):
            self.behind = 0.0
            return window
        kept = int(offsets_ns.searchsorted(begins_ns, side="left"))
        joined: dict[str, Any] = {
            name: np.concatenate((getattr(way, name)[:kept], getattr(window, name)))
            for name in _SAMPLES
        }
        return dataclasses.replace(
            window, offset_ns=np.concatenate((offsets_ns[:kept], window.offset_ns)), **joined
        )


def _from(window: ReferenceWindow, first: int) -> ReferenceWindow:
    """Return a window without the samples before one."""
    kept: dict[str, Any] = {name: getattr(window, name)[first:] for name in _SAMPLES}
    return dataclasses.replace(window, offset_ns=window.offset_ns[first:], **kept)


def _has_jumped(way: ReferenceWindow, window: ReferenceWindow) -> bool:
    """Whether a window begins elsewhere than the way before was to be by then."""
    both_ns = max(each.stamp_ns + int(each.offset_ns[0]) for each in (way, window))
    (p_before, _), (p_after, _) = way.pose_at(both_ns), window.pose_at(both_ns)
    return float(np.linalg.norm(p_after - p_before)) > _JUMP


def _is_over(way: ReferenceWindow, window: ReferenceWindow, behind: float) -> bool:
    """Whether the reference rests where it was ``behind`` seconds ago: nothing is ahead."""
    if window.v_WB_W[0].any() or window.a_WB_W[0].any():
        return False
    p_W, _ = way.pose_at(window.stamp_ns - round(1e9 * behind))
    return float(np.linalg.norm(window.p_WB[0] - p_W)) < _THERE
