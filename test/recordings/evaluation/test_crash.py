# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Crashes of recorded flights, by their odometry: how :class:`TrackedMotion` judges is tested with
campaigns.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from fixtures.recorded_flights import reference_track
from scipy.spatial.transform import Rotation

from quad_mpc_ros.recordings.evaluation.crash import TrackedMotion, crash_of
from quad_mpc_ros.recordings.evaluation.metrics import summarise
from quad_mpc_ros.recordings.flight import Flight

FlightMaker = Callable[..., Flight]
ABOVE = np.tile([0.0, 0.0, 2.0], (100, 1))


def rolled(angles: np.ndarray) -> np.ndarray:
    """Return the quaternions x, y, z, w of rolls."""
    return Rotation.from_euler("x", angles[:, None]).as_quat()


def test_flight_that_ends_upside_down_has_crashed(
    make_flight: FlightMaker,
) -> None:
    angles = np.concatenate((np.linspace(0.0, 2.9, 50), np.full(50, 2.9)))
    flight = make_flight(
        100, p_WB=ABOVE, reference=reference_track(ABOVE), q_WB_xyzw=rolled(angles)
    )
    summary = summarise(flight)
    assert summary["crashed"] is True
    assert summary["crash"] == "upside_down"
    assert summary["crash_time_s"] == pytest.approx(0.02 * np.argmax(angles > np.pi / 2))


def test_inverted_start_that_recovers_is_not_a_crash(make_flight: FlightMaker) -> None:
    angles = np.linspace(3.1, 0.0, 100)
    flight = make_flight(
        100, p_WB=ABOVE, reference=reference_track(ABOVE), q_WB_xyzw=rolled(angles)
    )
    assert crash_of(flight) is None


def test_noise_on_the_ground_after_a_landing_is_no_hard_landing(make_flight: FlightMaker) -> None:
    random = np.random.default_rng(1)
    height = np.concatenate((np.linspace(0.5, 0.0, 50), np.zeros(50)))
    p_WB = np.column_stack((np.zeros((100, 2)), height + 0.01 * random.normal(size=100)))
    down = np.column_stack((np.zeros((100, 2)), height - 0.05))
    flight = make_flight(100, p_WB=p_WB, reference=reference_track(down))
    assert crash_of(flight) is None


@pytest.mark.parametrize("missing", [0, 1, 3])
def test_a_swing_towards_a_jump_is_no_crash_where_odometry_is_missing(missing: int) -> None:
    flown = np.array([k for k in range(100) if not 50 <= k < 50 + missing])
    reference = np.tile([0.0, 0.0, 2.0], (len(flown), 1))
    reference[flown >= 50, 0] = 1.0
    swings = (flown >= 55) & (flown < 60)
    motion = TrackedMotion(
        time=0.02 * flown,
        p_WB=np.tile([0.0, 0.0, 2.0], (len(flown), 1)),
        tilt=np.where(swings, 2.0, 0.0),
        p_WB_reference=reference,
        tilt_reference=np.zeros(len(flown)),
    )
    assert motion.crash() is None


def test_crash_is_unknown_without_a_reference(make_flight: FlightMaker) -> None:
    summary = summarise(make_flight(100, reference=None))
    assert summary["crashed"] is None
