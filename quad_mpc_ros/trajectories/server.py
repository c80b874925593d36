"""The reference server: from a trajectory to the windows that are published."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.lie import Array
from quad_mpc_ros.model.samples import ReferenceWindow
from quad_mpc_ros.trajectories.config import ReferenceConfig
from quad_mpc_ros.trajectories.configured import configured_trajectory
from quad_mpc_ros.trajectories.trajectory import Trajectory, TrajectorySamples

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
        if not self._preview or not self.started:
            held = self._trajectory.at([now_ns, now_ns])
            return self._at_rest(stamp_ns, [0, self._duration_ns], held)
        offsets = list(range(0, self._duration_ns + 1, self._step_ns))
        samples = self._trajectory.at([now_ns + offset for offset in offsets])
        window = _window(stamp_ns, offsets, samples, self._config.frame_id)
        for jump_ns in self._trajectory.jumps(now_ns, now_ns + self._duration_ns):
            window = self._with_jump(window, jump_ns - now_ns, jump_ns)
        return window

    def whole(self) -> TrajectorySamples:
        """Return the whole trajectory once, to be drawn: every step and both sides of jumps.

        A long one is drawn in longer steps.
        """
        period = self._trajectory.period_ns
        grid = [*range(0, period, max(self._step_ns, period // _MOST_DRAWN)), period]
        times, parts = [], []
        for jump_ns in self._trajectory.jumps(0, period):
            times += [jump_ns, jump_ns]
            parts += [self._trajectory.before(jump_ns), self._trajectory.at([jump_ns])]
        # Last, so that a step at the time of a jump comes after both of its sides.
        times += grid
        parts.append(self._trajectory.at(grid))
        order = np.argsort(times, kind="stable")
        return _concatenated(parts, order)

    def _at_rest(
        self, stamp_ns: int, offsets: list[int], held: TrajectorySamples
    ) -> ReferenceWindow:
        """Return a window that holds a pose: without preview nothing is known to move."""
        rest = np.zeros((len(offsets), 3))
        samples = TrajectorySamples(
            p_WB=held.p_WB, q_WB_xyzw=held.q_WB_xyzw, v_WB_W=rest, a_WB_W=rest, w_WB_W=rest
        )
        return _window(stamp_ns, offsets, samples, self._config.frame_id)

    def _with_jump(self, window: ReferenceWindow, offset: int, jump_ns: int) -> ReferenceWindow:
        """Return the window with both sides of a jump as two samples of the same time."""
        place = int(np.searchsorted(window.offset_ns, offset, side="left"))
        sides = (self._trajectory.before(jump_ns), self._trajectory.at([jump_ns]))

        def inserted(values: Array, left: Array, right: Array) -> Array:
            return np.concatenate((values[:place], left, right, values[place:]))

        return ReferenceWindow(
            stamp_ns=window.stamp_ns,
            frame_id=window.frame_id,
            offset_ns=np.insert(window.offset_ns, place, [offset, offset]),
            p_WB=inserted(window.p_WB, *(side.p_WB for side in sides)),
            q_WB_xyzw=inserted(window.q_WB_xyzw, *(side.q_WB_xyzw for side in sides)),
            v_WB_W=inserted(window.v_WB_W, *(side.v_WB_W for side in sides)),
            a_WB_W=inserted(window.a_WB_W, *(side.a_WB_W for side in sides)),
            w_WB_W=inserted(window.w_WB_W, *(side.w_WB_W for side in sides)),
        )


def _window(
    stamp_ns: int, offsets: list[int], samples: TrajectorySamples, frame_id: str
) -> ReferenceWindow:
    return ReferenceWindow(
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        offset_ns=np.array(offsets, dtype=np.int64),
        p_WB=samples.p_WB,
        q_WB_xyzw=samples.q_WB_xyzw,
        v_WB_W=samples.v_WB_W,
        a_WB_W=samples.a_WB_W,
        w_WB_W=samples.w_WB_W,
    )


def _concatenated(parts: list[TrajectorySamples], order: np.ndarray) -> TrajectorySamples:
    def joined(name: str) -> Array:
        return np.asarray(np.concatenate([getattr(part, name) for part in parts])[order])

    names = ("p_WB", "q_WB_xyzw", "v_WB_W", "a_WB_W", "w_WB_W")
    return TrajectorySamples(**{name: joined(name) for name in names})
