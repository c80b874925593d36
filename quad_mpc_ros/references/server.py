# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The reference server: from a trajectory to the windows that are published."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.model.samples import ReferenceWindow
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.references.trajectory import (
    Trajectory,
    TrajectorySamples,
    combined,
    resting,
)

_BEFORE_START_NS = -1
_MAX_DRAWN_SAMPLES = 10_000
_BLOCK_SIZE = 256


class ReferenceServer:
    """Cuts windows out of the configured or a given trajectory.

    Until :meth:`start` the trajectory is held at its beginning, at rest. Smooth trajectories are
    always previewed.
    """

    def __init__(self, config: ReferenceConfig, trajectory: Trajectory | None = None) -> None:
        self._config = config
        self._trajectory = configured_trajectory(config) if trajectory is None else trajectory
        self._preview = config.preview or self._trajectory.smooth
        self._duration_ns = round(config.window_duration * 1e9)
        self._step_ns = round(config.window_step * 1e9)
        self._grid_ns = np.arange(0, self._duration_ns + 1, self._step_ns, dtype=np.int64)
        self._started_ns: int | None = None

    @property
    def fixed(self) -> bool:
        """Whether the trajectory is declared as never changing."""
        return getattr(self._trajectory, "fixed", False) is True

    @property
    def started(self) -> bool:
        """Whether the trajectory has started."""
        return self._started_ns is not None

    def start(self, stamp_ns: int) -> None:
        """Begin the trajectory at a stamp."""
        self._started_ns = stamp_ns

    def window(self, stamp_ns: int) -> ReferenceWindow:
        """Return the reference from ``stamp_ns`` on."""
        return self.windows([stamp_ns])[0]

    def windows(self, stamps_ns: Sequence[int]) -> list[ReferenceWindow]:
        """Return the reference from each stamp on.

        The trajectory is sampled once: many stamps take little longer than one.
        """
        begin_ns = self._started_ns
        starts = [
            _BEFORE_START_NS if begin_ns is None else stamp_ns - begin_ns for stamp_ns in stamps_ns
        ]
        previewed = self._preview and self.started
        cuts = [self._previewed(now_ns) if previewed else self._held(now_ns) for now_ns in starts]
        sampled = np.concatenate([cut.sampled for cut in cuts])
        times, places = np.unique(sampled, return_inverse=True)  # windows overlap
        once = self._trajectory.at(times.tolist())
        samples = combined(lambda values: values[places], once)
        if not previewed:  # without preview, nothing moves
            samples = resting(samples)
        windows, end = [], 0
        for stamp_ns, now_ns, cut in zip(stamps_ns, starts, cuts, strict=True):
            part = slice(end, end := end + len(cut.sampled))
            windows.append(
                ReferenceWindow(
                    stamp_ns=stamp_ns,
                    offset_ns=cut.published - now_ns,
                    p_WB=samples.p_WB[part],
                    q_WB_xyzw=samples.q_WB_xyzw[part],
                    v_WB_W=samples.v_WB_W[part],
                    a_WB_W=samples.a_WB_W[part],
                    w_WB_W=samples.w_WB_W[part],
                    frame_id=self._config.frame_id,
                )
            )
        return windows

    def changes(self, after_ns: int, until_ns: int) -> bool:
        """Whether the reference jumps between two stamps without preview."""
        if self._started_ns is None or self._preview:
            return False
        start_ns = self._started_ns
        return bool(self._trajectory.jumps(after_ns - start_ns, until_ns - start_ns))

    def whole(self) -> TrajectorySamples:
        """Return the whole trajectory once, for drawing: every step and both sides of jumps.

        A long trajectory has longer steps.
        """
        period = self._trajectory.period_ns
        grid = [*range(0, period, max(self._step_ns, period // _MAX_DRAWN_SAMPLES)), period]
        return self._trajectory.at(
            self._with_jumps(np.array(grid), end_ns=period).sampled.tolist()
        )

    def _held(self, now_ns: int) -> _Times:
        """Return the current sample twice: it is held over the window."""
        return _Times(
            published=np.array((now_ns, now_ns + self._duration_ns)),
            sampled=np.array((now_ns, now_ns)),
        )

    def _previewed(self, now_ns: int) -> _Times:
        """Return every step of the window, and both sides of its jumps."""
        return self._with_jumps(now_ns + self._grid_ns, end_ns=now_ns + self._duration_ns)

    def _with_jumps(self, grid: NDArray[np.int64], *, end_ns: int) -> _Times:
        """Return times that include each jump up to ``end_ns`` twice.

        Both entries are the sides of the jump; a sample at the same time comes after both.
        """
        jumps = self._trajectory.jumps(int(grid[0]), end_ns)
        if not jumps:
            return _Times(published=grid, sampled=grid)
        at_jumps = np.repeat(jumps, 2)
        published = np.concatenate((at_jumps, grid))
        sampled = np.concatenate((at_jumps - np.tile((1, 0), len(jumps)), grid))
        order = np.argsort(published, kind="stable")
        return _Times(published=published[order], sampled=sampled[order])


class WindowsAhead:
    """Windows of known stamps, cut in blocks, or one by one if the trajectory may change."""

    def __init__(self, server: ReferenceServer, stamps_ns: Iterable[int]) -> None:
        """Take the stamps in order; some may be skipped later."""
        self._server = server
        self._stamps_ns = iter(stamps_ns)
        self._ahead: deque[ReferenceWindow] = deque()

    def window(self, stamp_ns: int) -> ReferenceWindow:
        """Return the window of a stamp and drop earlier windows.

        Raises ``ValueError`` for a stamp that is not among the remaining stamps.
        """
        if not self._server.fixed:
            return self._server.window(stamp_ns)
        while True:
            if not self._ahead:
                block = [*itertools.islice(self._stamps_ns, _BLOCK_SIZE)]
                if not block:
                    raise ValueError(f"stamp {stamp_ns} ns is unknown or already used")
                self._ahead.extend(self._server.windows(block))
            window = self._ahead.popleft()
            if window.stamp_ns == stamp_ns:
                return window


class _Times(NamedTuple):
    """The times of a window's samples (n,): as published, and as sampled from the trajectory."""

    published: NDArray[np.int64]
    sampled: NDArray[np.int64]
