# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Successive trajectories on a clock, and the time of a flight."""

from __future__ import annotations

import bisect
import dataclasses
from dataclasses import dataclass

import numpy as np

from quad_mpc_ros.control.estimation.clock_offset import PersistentOffset
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.references.trajectory import Trajectory, TrajectorySamples, combined

_KEPT_PHASES = 8  # that have ended, for slightly older windows
# Offset from which stamps are of another clock, its tolerance, and how long it has to last.
_MIN_OFFSET_NS, _TOLERANCE_NS, _CONFIRMATION_NS = 200_000_000, 100_000_000, 50_000_000


@dataclass(frozen=True, kw_only=True)
class Phase:
    """A trajectory with its name and start time."""

    start_ns: int
    name: str
    trajectory: Trajectory


class Timeline:
    """A trajectory over the time of a clock, made of phases; each lasts until the next begins.

    The list of phases is never modified, only replaced, so that :meth:`snapshot` may be called in
    another thread.
    """

    smooth = True
    period_ns = 0

    def __init__(self, phases: list[Phase]) -> None:
        self._phases = phases

    def snapshot(self) -> Timeline:
        """Return an immutable copy of the timeline."""
        return Timeline(self._phases)

    @property
    def version(self) -> object:
        """The object is unchanged as long as the phases are."""
        return self._phases

    def phase(self, time_ns: int) -> Phase:
        """Return the phase at a time; before its beginning, the first phase."""
        phases = self._phases
        return phases[_owner(phases, time_ns)]

    @property
    def last(self) -> Phase:
        """The last phase."""
        return self._phases[-1]

    def follow(self, phases: list[Phase]) -> None:
        """Replace all phases from the start of the first given phase on, in order of time."""
        start_ns = phases[0].start_ns
        kept = [phase for phase in self._phases if phase.start_ns < start_ns]
        self._phases = [*kept[-_KEPT_PHASES:], *phases]

    def reset_estimate(self, reset: EstimateReset) -> None:
        """Transform all phases by an announced odometry jump."""
        self._phases = [
            dataclasses.replace(phase, trajectory=ResetTrajectory(phase.trajectory, reset))
            for phase in self._phases
        ]

    def at(self, times_ns: list[int]) -> TrajectorySamples:
        """Return the samples at these times."""
        phases = self._phases  # another thread may replace them meanwhile
        owners = np.array([_owner(phases, time_ns) for time_ns in times_ns])
        parts, places = [], []
        for number in np.unique(owners).tolist():
            phase, mine = phases[number], np.flatnonzero(owners == number).tolist()
            parts.append(phase.trajectory.at([times_ns[i] - phase.start_ns for i in mine]))
            places += mine
        order = np.argsort(places)
        return combined(lambda *arrays: np.concatenate(arrays)[order], *parts)

    def jumps(self, start_ns: int, end_ns: int) -> list[int]:
        """Return the jumps inside the phases in (start, end]; between phases there are none."""
        found, phases = [], self._phases
        ends = [*(phase.start_ns - 1 for phase in phases[1:]), end_ns]
        for phase, last in zip(phases, ends, strict=True):
            first, last = max(start_ns, phase.start_ns), min(last, end_ns)
            if first < last:
                inside = phase.trajectory.jumps(first - phase.start_ns, last - phase.start_ns)
                found += [phase.start_ns + time_ns for time_ns in inside]
        return found


class ResetTrajectory:
    """A trajectory transformed by an odometry jump."""

    def __init__(self, trajectory: Trajectory, reset: EstimateReset) -> None:
        self._trajectory, self._reset = trajectory, reset
        self.jumps, self.smooth = trajectory.jumps, trajectory.smooth
        self.period_ns = trajectory.period_ns

    def at(self, times_ns: list[int]) -> TrajectorySamples:
        """Return the samples at these times."""
        return TrajectorySamples(**self._reset.samples(self._trajectory.at(times_ns)))


def _owner(phases: list[Phase], time_ns: int) -> int:
    started = bisect.bisect_right(phases, time_ns, key=lambda phase: phase.start_ns)
    return max(started - 1, 0)


class FlightTime:
    """The time of a flight, which pauses while nothing is published.

    All times are nanoseconds of the clock of the stamps.
    """

    def __init__(self) -> None:
        self._paused_ns = 0
        self._since_ns: int | None = None

    def pause(self, now_ns: int) -> None:
        """Pause the time of the flight."""
        self._since_ns = now_ns

    def resume(self, now_ns: int) -> None:
        """Continue after a pause; a pause in which the clock was set back counts as 0."""
        if self._since_ns is not None:
            self._paused_ns += max(0, now_ns - self._since_ns)
            self._since_ns = None

    def at(self, stamp_ns: int) -> int:
        """Return the time of the flight at a stamp."""
        return stamp_ns - self._paused_ns


class StampClock:
    """Offset of the odometry's clock from the flight's clock; 0 if they agree.

    With an offset the flight has a separate clock; windows have stamps of the odometry's.
    """

    def __init__(self) -> None:
        self.ahead_ns = 0
        self._misfits = PersistentOffset()

    def note(self, stamp_ns: int, *, now_ns: int) -> None:
        """Take the stamp of an odometry that arrives now."""
        ahead_ns = stamp_ns - now_ns
        if abs(ahead_ns - self.ahead_ns) <= _MIN_OFFSET_NS:
            self._misfits.clear()
            return
        lasting_ns = self._misfits.duration_ns(ahead_ns, now_ns=now_ns, tolerance_ns=_TOLERANCE_NS)
        if lasting_ns >= _CONFIRMATION_NS:
            self.ahead_ns = 0 if abs(ahead_ns) <= _MIN_OFFSET_NS else ahead_ns
            self._misfits.clear()
