"""The outcome of a flight by its true states, not the measured ones: crashed, settled, tilted."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.simulation.closed_loop import LoopStep

_AIRBORNE = 0.1  # m; this high it flies
_HARD = 1.0  # m/s downwards: touching the ground faster is no landing
_FARTHEST = 5.0  # m from the box of the reference and the start
_TURNED_OVER = math.pi / 2
_MORE_THAN_ASKED = math.radians(60.0)  # of tilt; a flip lags behind its reference

FIGURES = (
    "settled_error_mean_m",
    "settled_error_max_m",
    "tilt_max_rad",
    "settled_tilt_max_rad",
    "speed_max_m_s",
    "altitude_min_m",
    "rates_rms_rad_s",
)


@dataclass(frozen=True, kw_only=True)
class Crash:
    """How a flight was lost, and when [s]: ``ground``, ``upside_down`` or ``away``."""

    kind: str
    time: float


@dataclass(kw_only=True)
class TruthLog:
    """The true states of a flight at its odometries, and the reference there."""

    stamps_ns: list[int] = field(default_factory=list)
    rows: list[Array] = field(default_factory=list)

    def take(self, step: LoopStep) -> None:
        """Take the next step."""
        truth, window = step.truth, step.window
        self.stamps_ns.append(truth.stamp_ns)
        self.rows += (truth.p_WB, truth.v_WB_B, truth.w_WB_B, truth.q_WB_xyzw)
        self.rows += (window.p_WB[0], window.q_WB_xyzw[0])

    def truth(self) -> Truth:
        """Return the states as arrays, from the first step on."""
        stamps_ns = np.array(self.stamps_ns, dtype=np.int64)
        rows = np.concatenate(self.rows).reshape(len(stamps_ns), -1)
        p, v, w, q, p_reference, q_reference = np.split(rows, [3, 6, 9, 13, 16], axis=1)
        return Truth(
            time=1e-9 * (stamps_ns - stamps_ns[0]),
            p_WB=p,
            v_WB_B=v,
            w_WB_B=w,
            tilt=_tilt(q),
            p_WB_reference=p_reference,
            tilt_reference=_tilt(q_reference),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """True states of n odometries.

    Shapes: ``time`` [s], ``tilt``, ``tilt_reference`` [rad], of the thrust axis from the vertical,
    (n,); ``p_WB``, ``p_WB_reference`` [m], ``v_WB_B`` [m/s], ``w_WB_B`` [rad/s] (n, 3).
    """

    time: Array
    p_WB: Array
    v_WB_B: Array
    w_WB_B: Array
    tilt: Array
    p_WB_reference: Array
    tilt_reference: Array

    def crash(self) -> Crash | None:
        """Return the first crash: into the ground in flight, upside down, or far away."""
        found = [
            Crash(kind=kind, time=float(self.time[np.argmax(when)]))
            for kind, when in (
                ("ground", self._hits_ground()),
                ("upside_down", self._turned_over()),
                ("away", self._away()),
            )
            if when.any()
        ]
        return min(found, key=lambda crash: crash.time, default=None)

    def figures(self, *, settle_time: float) -> dict[str, float | None]:
        """Return the values of :data:`FIGURES`; ``settled`` ones count from a time [s] on."""
        settled = self.time >= settle_time
        error = np.linalg.norm(self.p_WB_reference - self.p_WB, axis=1)[settled]
        speed = np.linalg.norm(self.v_WB_B, axis=1)
        flown = self.p_WB[self._was_airborne(), 2]
        values = (
            float(error.mean()) if len(error) else None,
            float(error.max()) if len(error) else None,
            float(self.tilt.max()),
            float(self.tilt[settled].max()) if len(error) else None,
            float(speed.max()),
            float(flown.min()) if len(flown) else None,
            float(np.sqrt(np.mean(np.sum(self.w_WB_B**2, axis=1)))),
        )
        return dict(zip(FIGURES, values, strict=True))

    def _was_airborne(self) -> NDArray[np.bool_]:
        """Return at which odometries it had already been in the air."""
        return np.asarray(np.logical_or.accumulate(self.p_WB[:, 2] > _AIRBORNE))

    def _hits_ground(self) -> NDArray[np.bool_]:
        """Return where it is on the ground after it flew, unasked or too fast."""
        down = (self.p_WB[:, 2] <= 0.0) & self._was_airborne()
        asked = self.p_WB_reference[:, 2] <= _AIRBORNE
        descent = -np.diff(self.p_WB[:, 2], prepend=self.p_WB[0, 2])
        hard = descent > _HARD * np.diff(self.time, prepend=self.time[0])
        return np.asarray(down & (hard | ~asked))

    def _turned_over(self) -> NDArray[np.bool_]:
        beyond = self.tilt > self.tilt_reference + _MORE_THAN_ASKED
        return np.asarray((self.tilt > _TURNED_OVER) & beyond)

    def _away(self) -> NDArray[np.bool_]:
        box = np.vstack((self.p_WB_reference, self.p_WB[:1]))
        outside = self.p_WB - np.clip(self.p_WB, box.min(axis=0), box.max(axis=0))
        return np.asarray(np.linalg.norm(outside, axis=1) > _FARTHEST)


def verdict(crash: Crash | None) -> dict[str, Any]:
    """Return a crash, or none, as cells of the table."""
    if crash is None:
        return {"crashed": False, "crash": None, "crash_time_s": None}
    return {"crashed": True, "crash": crash.kind, "crash_time_s": crash.time}


def _tilt(q_WB_xyzw: Array) -> Array:
    """Return the angles (n,) between thrust axes and the vertical [rad]."""
    x, y, z, w = q_WB_xyzw.T
    # Exact near zero, where the cosine alone is not.
    return np.asarray(2.0 * np.arctan2(np.hypot(x, y), np.hypot(z, w)))
