# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Crash detection for simulated and recorded flights."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.recordings.flight import Flight

_AIRBORNE_HEIGHT = 0.1  # m; this high it flies
_MAX_LANDING_SPEED = 1.0  # m/s downwards: touching the ground faster is no landing
_DESCENT_TIME = 0.1  # s over which a descent is measured: noise of a single position is not one
_MAX_DISTANCE = 5.0  # m from the box of the reference and the start
_TURNED_OVER_TILT = math.pi / 2
_MAX_SWING, _JUMP_MEMORY = 0.25, 1.0  # s: a swing after a jump of the reference is shorter
_JUMP_SPEED = 25.0  # m/s: a reference that moves faster jumps
_BRIEF_JUMP_SPEED = 8.0  # m/s: and one that does so from one odometry to the next, and no longer
_EXCESS_TILT = math.radians(60.0)  # of tilt; a flip lags behind its reference

_CAUSE_TEXTS = {
    "obstacle": "collision with an obstacle",
    "ground": "ground contact without a landing in the reference, or too fast",
    "upside_down": "tilt beyond 90° and 60° more than the reference",
    "away": f"more than {_MAX_DISTANCE:g} m away from the reference and the start",
}


@dataclass(frozen=True, kw_only=True)
class Crash:
    """Kind and time [s] of a crash: ``ground``, ``upside_down``, ``away`` or ``obstacle``."""

    kind: str
    time: float


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackedMotion:
    """Positions and tilts at n odometries, with the reference.

    Shapes: ``time`` [s], ``tilt``, ``tilt_reference`` [rad], of the thrust axis from the vertical,
    (n,); ``p_WB``, ``p_WB_reference`` [m] (n, 3). The ground is at height 0.
    """

    time: Array
    p_WB: Array
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

    def _hits_ground(self) -> NDArray[np.bool_]:
        """Return where the vehicle is on the ground after flight, unintended or too fast."""
        down = (self.p_WB[:, 2] <= 0.0) & was_airborne(self.p_WB)
        asked = self.p_WB_reference[:, 2] <= _AIRBORNE_HEIGHT
        return np.asarray(down & ((self._descent() > _MAX_LANDING_SPEED) | ~asked))

    def _descent(self) -> Array:
        """Return the recent descent speed [m/s]."""
        places = np.arange(len(self.time))
        before = np.searchsorted(self.time, self.time - _DESCENT_TIME + 1e-6, side="right") - 1
        before = np.clip(before, 0, np.maximum(places - 1, 0))
        duration = np.where(places > before, self.time - self.time[before], 1.0)
        return np.asarray((self.p_WB[before, 2] - self.p_WB[:, 2]) / duration)

    def _turned_over(self) -> NDArray[np.bool_]:
        """Return where the vehicle is unintentionally upside down, except at an inverted start.

        After a jump of the reference the vehicle may briefly tilt beyond 90 degrees.
        """
        upright = np.logical_or.accumulate(self.tilt <= _TURNED_OVER_TILT)
        beyond = self.tilt > self.tilt_reference + _EXCESS_TILT
        turned = upright & (self.tilt > _TURNED_OVER_TILT) & beyond
        to_the_end = np.logical_and.accumulate(turned[::-1])[::-1]
        swings = self._just_jumped() & (self._time_ahead(turned) < _MAX_SWING - 1e-6) & ~to_the_end
        return np.asarray(turned & ~swings)

    def _just_jumped(self) -> NDArray[np.bool_]:
        """Return where the reference has recently jumped or the flight has just begun."""
        steps = np.linalg.norm(np.diff(self.p_WB_reference, axis=0), axis=1)
        speeds = steps / np.maximum(np.diff(self.time), 1e-9)
        beside = np.concatenate(([0.0], speeds, [0.0]))
        # If odometry is missing, a jump takes longer: compare its speed with the speeds beside it.
        sudden = speeds - np.maximum(beside[:-2], beside[2:]) > _BRIEF_JUMP_SPEED
        jumps = np.append(True, (speeds > _JUMP_SPEED) | sudden)
        last = np.maximum.accumulate(np.where(jumps, self.time, -np.inf))
        return np.asarray(self.time - last <= _JUMP_MEMORY)

    def _time_ahead(self, when: NDArray[np.bool_]) -> Array:
        """Return for how long (n,) [s] of the time shortly ahead a condition is true."""
        until = np.append(self.time[1:], self.time[-1])
        spent = np.concatenate(([0.0], np.cumsum(np.where(when, until - self.time, 0.0))))
        ahead = np.searchsorted(self.time, self.time + _JUMP_MEMORY)
        return np.asarray(spent[ahead] - spent[:-1])

    def _away(self) -> NDArray[np.bool_]:
        box = np.vstack((self.p_WB_reference, self.p_WB[:1]))
        outside = self.p_WB - np.clip(self.p_WB, box.min(axis=0), box.max(axis=0))
        return np.asarray(np.linalg.norm(outside, axis=1) > _MAX_DISTANCE)


def was_airborne(p_WB: Array) -> NDArray[np.bool_]:
    """Return at which of successive positions (n, 3) the vehicle had already been in the air."""
    return np.asarray(np.logical_or.accumulate(p_WB[:, 2] > _AIRBORNE_HEIGHT))


def crash_of(flight: Flight) -> Crash | None:
    """Return the first crash of a flight, if any; requires a reference."""
    followed = flight.followed
    if followed is None:
        return None
    into = collision_of(flight)
    hit = None if into is None else Crash(kind="obstacle", time=float(flight.time[into]))
    moved = TrackedMotion(
        time=flight.time,
        p_WB=flight.p_WB,
        tilt=tilts(flight.q_WB_xyzw),
        p_WB_reference=followed.p_WB,
        tilt_reference=tilts(so3.quaternion_xyzw_from_rotation(followed.R_WB)),
    ).crash()
    return min(filter(None, (hit, moved)), key=lambda crash: crash.time, default=None)


def collision_of(flight: Flight) -> int | None:
    """Return the number of the first odometry in contact with an obstacle, if any.

    If the flight ended there, the last odometry counts, even if slightly later.
    """
    clearance = flight.clearance
    if clearance is None or not (clearance <= 0.0).any():
        return None
    return int(np.argmax(clearance <= 0.0))


def crash_figures(crash: Crash | None) -> dict[str, Any]:
    """Return a crash, if any, as figures of a summary and cells of a table."""
    if crash is None:
        return {"crashed": False, "crash": None, "crash_time_s": None}
    return {"crashed": True, "crash": crash.kind, "crash_time_s": crash.time}


def crash_text(kind: str, time: float) -> str:
    """Return a crash in words; ``time`` [s]."""
    return f"crashed at {time:.2f} s: {_CAUSE_TEXTS[kind]}"


def tilts(q_WB_xyzw: Array) -> Array:
    """Return the angles (n,) between thrust axes and the vertical [rad]."""
    x, y, z, w = q_WB_xyzw.T
    # Exact near zero, where the cosine alone is not.
    return np.asarray(2.0 * np.arctan2(np.hypot(x, y), np.hypot(z, w)))
