"""The outcome of a flight, from its true states: crash, settled error, tilt."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.recordings.evaluation.crash import Crash, TrackedMotion, tilts
from quad_mpc_ros.simulation.closed_loop import LoopStep
from quad_mpc_ros.simulation.surroundings import Collision

FIGURES = (
    "settled_error_mean_m",
    "settled_error_max_m",
    "tilt_max_rad",
    "settled_tilt_max_rad",
    "speed_max_m_s",
    "altitude_min_m",
    "rates_rms_rad_s",
)


@dataclass(kw_only=True)
class TruthLog:
    """The true states of a flight at each odometry, with the reference."""

    stamps_ns: list[int] = field(default_factory=list)
    rows: list[Array] = field(default_factory=list)
    behind: list[float] = field(default_factory=list)
    collision: Collision | None = None

    def take(self, step: LoopStep) -> None:
        """Add a step."""
        truth, window = step.truth, step.window
        self.collision = step.collision
        self.stamps_ns.append(truth.stamp_ns)
        self.rows += (truth.p_WB, truth.v_WB_B, truth.w_WB_B, truth.q_WB_xyzw)
        self.rows += (window.p_WB[0], window.q_WB_xyzw[0])
        before = self.behind[-1] if self.behind else 0.0
        self.behind.append(before if step.tick is None else step.tick.behind)

    def truth(self) -> Truth:
        """Return the states as arrays."""
        stamps_ns = np.array(self.stamps_ns, dtype=np.int64)
        rows = np.concatenate(self.rows).reshape(len(stamps_ns), -1)
        p, v, w, q, p_reference, q_reference = np.split(rows, [3, 6, 9, 13, 16], axis=1)
        motion = TrackedMotion(
            time=1e-9 * (stamps_ns - stamps_ns[0]),
            p_WB=p,
            tilt=tilts(q),
            p_WB_reference=p_reference,
            tilt_reference=tilts(q_reference),
        )
        motion = motion.late(np.array(self.behind))
        return Truth(motion=motion, v_WB_B=v, w_WB_B=w, collision=self.collision)


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """True states at n odometries: the motion, ``v_WB_B`` [m/s] and ``w_WB_B`` [rad/s] (n, 3).

    ``collision`` is the collision that ended the flight, if any.
    """

    motion: TrackedMotion
    v_WB_B: Array
    w_WB_B: Array
    collision: Collision | None = None

    def crash(self) -> Crash | None:
        """Return the first crash, if any."""
        found = [self.motion.crash()]
        if self.collision is not None:
            found.append(Crash(kind="obstacle", time=self.collision.time))
        return min(filter(None, found), key=lambda crash: crash.time, default=None)

    def figures(self, *, settle_time: float) -> dict[str, float | None]:
        """Return the values of :data:`FIGURES`; ``settled`` figures start at a time [s]."""
        motion = self.motion
        settled = motion.time >= settle_time
        error = np.linalg.norm(motion.p_WB_reference - motion.p_WB, axis=1)[settled]
        speed = np.linalg.norm(self.v_WB_B, axis=1)
        flown = motion.p_WB[motion.was_airborne(), 2]
        values = (
            float(error.mean()) if len(error) else None,
            float(error.max()) if len(error) else None,
            float(motion.tilt.max()),
            float(motion.tilt[settled].max()) if len(error) else None,
            float(speed.max()),
            float(flown.min()) if len(flown) else None,
            float(np.sqrt(np.mean(np.sum(self.w_WB_B**2, axis=1)))),
        )
        return dict(zip(FIGURES, values, strict=True))
