"""The reference server: from a trajectory to the windows that are published."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.model.samples import ReferenceWindow
from quad_mpc_ros.trajectories.config import ReferenceConfig
from quad_mpc_ros.trajectories.configured import configured_trajectory
from quad_mpc_ros.trajectories.trajectory import (
    Trajectory,
    TrajectorySamples,
    at_rest,
    combined,
)

_BEFORE_START_NS = -1
_MOST_DRAWN = 10_000


class ReferenceServer:
    """Cuts windows out of a trajectory, the configured one unless another is given.

    Until :meth:`start` the trajectory is held at its beginning, at rest. What is smooth is always
    previewed.
    """

    def __init__(self, config: ReferenceConfig, trajectory: Trajectory | None = None) -> None:
        self._config = config
        self._trajectory = configured_trajectory(config) if trajectory is None else trajectory
        self._preview = config.preview or self._trajectory.smooth
        self._duration_ns = round(config.window_duration * 1e9)
        self._step_ns = round(config.window_step * 1e9)
        self._started_ns: int | None = None

    @property
    def started(self) -> bool:
        """Whether the trajectory's time runs."""
        return self._started_ns is not None

    def start(self, stamp_ns: int) -> None:
        """Let the trajectory begin at a stamp."""
        self._started_ns = stamp_ns

    def window(self, stamp_ns: int) -> ReferenceWindow:
        """Return the reference from ``stamp_ns`` on."""
        now_ns = _BEFORE_START_NS if self._started_ns is None else stamp_ns - self._started_ns
        if self._preview and self.started:
            grid = range(now_ns, now_ns + self._duration_ns + 1, self._step_ns)
            times, samples = self._with_jumps([*grid], end_ns=now_ns + self._duration_ns)
        else:  # nothing is known to move
            held = self._trajectory.at([now_ns, now_ns])
            times = np.array([now_ns, now_ns + self._duration_ns])
            samples = dataclasses.replace(at_rest(held.p_WB), q_WB_xyzw=held.q_WB_xyzw)
        return ReferenceWindow(
            stamp_ns=stamp_ns,
            offset_ns=times - now_ns,
            frame_id=self._config.frame_id,
            **vars(samples),
        )

    def whole(self) -> TrajectorySamples:
        """Return the whole trajectory once, to be drawn: every step and both sides of jumps.

        A long one is drawn in longer steps.
        """
        period = self._trajectory.period_ns
        grid = [*range(0, period, max(self._step_ns, period // _MOST_DRAWN)), period]
        return self._with_jumps(grid, end_ns=period)[1]

    def _with_jumps(
        self, times: list[int], *, end_ns: int
    ) -> tuple[NDArray[np.int64], TrajectorySamples]:
        """Return times with each jump up to ``end_ns`` twice among them, and the samples there.

        The two are both sides of the jump; a sample at its time comes after both.
        """
        jumps = self._trajectory.jumps(times[0], end_ns)
        sides = [jump - before for jump in jumps for before in (1, 0)]
        samples = self._trajectory.at([*sides, *times])
        shown = np.array([*(jump for jump in jumps for _ in (1, 0)), *times], dtype=np.int64)
        order = np.argsort(shown, kind="stable")
        return shown[order], combined(lambda values: values[order], samples)
