# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Crashes and figures of flights that are drawn by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quad_mpc_ros import MpcConfig, ReferenceConfig, SimulatorConfig
from quad_mpc_ros.control.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.extras.campaigns.flight import FIGURES, figures_of
from quad_mpc_ros.recordings.evaluation import crash
from quad_mpc_ros.recordings.evaluation.simulated import FlightConfig, FlightLog
from quad_mpc_ros.simulation.closed_loop import LoopStep
from quad_mpc_ros.simulation.shapes import Scene, Sphere

HOVER = np.array([0.0, 0.0, 2.0])


def flown(
    p_WB,
    *,
    tilts=None,
    reference=HOVER,
    reference_tilts=None,
    v_WB_B=(0.0, 0.0, 0.0),
    scene=None,
):
    """Return the truth of a flight at 10 Hz through positions (n, 3), rolled by angles (n,)."""
    count = len(p_WB)
    tilts = np.zeros(count) if tilts is None else np.asarray(tilts)
    reference_tilts = np.zeros(count) if reference_tilts is None else np.asarray(reference_tilts)
    reference = np.broadcast_to(reference, (count, 3))
    log = FlightLog(MpcConfig(), scene)
    for k in range(count):
        # Yaw and the sign of the quaternion say nothing of the tilt.
        attitude = (Rotation.from_euler("z", 0.7) * Rotation.from_euler("x", tilts[k])).as_quat()
        truth = OdometrySample(
            stamp_ns=1_000_000_000 + k * 100_000_000,
            p_WB=np.asarray(p_WB[k], dtype=float),
            q_WB_xyzw=-attitude if k % 2 else attitude,
            v_WB_B=np.asarray(v_WB_B, dtype=float),
            w_WB_B=np.array([1.0, 2.0, 2.0]),
        )
        window = ReferenceWindow(
            stamp_ns=truth.stamp_ns,
            offset_ns=np.array([0, 1]),
            p_WB=np.tile(reference[k], (2, 1)),
            q_WB_xyzw=np.tile(Rotation.from_euler("y", reference_tilts[k]).as_quat(), (2, 1)),
            v_WB_W=np.zeros((2, 3)),
            a_WB_W=np.zeros((2, 3)),
            w_WB_W=np.zeros((2, 3)),
        )
        log.take(
            LoopStep(
                odometry=replace(truth, p_WB=truth.p_WB + 100.0),
                truth=truth,
                sent_ns=truth.stamp_ns,
                window=window,
                tick=None,
                command=None,
            )
        )
    return log.with_truth(
        log.flight(FlightConfig(MpcConfig(), SimulatorConfig(), ReferenceConfig()))
    )


def line(*heights):
    return [(0.0, 0.0, height) for height in heights]


def crash_of(truth):
    found = crash.crash_of(truth)
    return None if found is None else (found.kind, round(found.time, 6))


DESCENT = line(0.3, 0.2, 0.1, 0.0, 0.0, 0.0)
DIVE = line(0.9, 0.6, 0.3, 0.0, 0.0)
FALL = {"tilts": np.radians([0, 0, 170, 170])}


@pytest.mark.parametrize(
    ("p_WB", "given", "expected"),
    [
        pytest.param(line(0.0, 0.0, 0.05, 0.0, 0.5, 2.0), {}, None, id="lift-off"),
        pytest.param(line(2.0, 1.95, 0.05, 0.0, 0.0), {}, ("ground", 0.3), id="ground"),
        pytest.param(
            line(0.3, 0.2, 0.12, 0.04, 0.0, 0.0),
            {"reference": np.array(DESCENT)},
            None,
            id="gentle landing",
        ),
        pytest.param(DIVE, {"reference": np.array(DIVE)}, ("ground", 0.3), id="hard landing"),
        pytest.param(
            [HOVER] * 5,
            {"tilts": np.radians([0, 60, 89, 91, 180])},
            ("upside_down", 0.3),
            id="upside down",
        ),
        pytest.param(line(2.0, 8.0, 1.0, 0.0), FALL, ("away", 0.1), id="first crash counts"),
    ],
)
def test_crash_of_a_flight(p_WB, given, expected):
    assert crash_of(flown(p_WB, **given)) == expected


def test_a_swing_towards_a_reference_that_has_jumped_is_no_crash():
    count = 40
    swing = np.zeros(count)
    swing[[2, 3]] = np.radians([95, 105])
    assert crash_of(flown([HOVER] * count, tilts=swing)) is None  # at the start
    later = np.roll(swing, 20)
    assert crash_of(flown([HOVER] * count, tilts=later)) == ("upside_down", 2.2)
    jumping = np.tile(HOVER, (count, 1))
    jumping[20:, 0] = 3.0
    assert crash_of(flown([HOVER] * count, tilts=later, reference=jumping)) is None
    longer = later.copy()
    longer[24:26] = np.radians(95)
    truth = flown([HOVER] * count, tilts=longer, reference=jumping)
    assert crash_of(truth) == ("upside_down", 2.2)


def test_upside_down_like_the_reference_is_no_crash():
    asked = np.radians([0, 60, 120, 180, 180])
    assert (
        crash_of(flown([HOVER] * 5, tilts=asked[[0, 0, 1, 2, 3]], reference_tilts=asked)) is None
    )
    still_upside_down = np.radians([0, 60, 120, 180, 179])
    back = np.radians([0, 60, 120, 180, 0])
    truth = flown([HOVER] * 5, tilts=still_upside_down, reference_tilts=back)
    assert crash_of(truth) == ("upside_down", 0.4)


def test_far_from_the_box_of_the_reference_and_the_start_is_a_crash():
    reference = np.array([(x, 0.0, 2.0) for x in (0, 5, 10, 10, 10)])
    inside = [(0, -4.9, 2), (5, 4.9, 2), (14.9, 0, 2), (14, 2, 2), (10, 0, 6.9)]
    assert crash_of(flown(inside, reference=reference)) is None
    outside = [*inside[:4], (14, -8.1, 2)]  # 4 m and 3.2 m beyond the sides
    assert crash_of(flown(outside, reference=reference)) == ("away", 0.4)
    far_start = [(30, 0, 2), (20, 0, 2), (10, 0, 2), (5, 0, 2), (0, 0, 2)]
    assert crash_of(flown(far_start, reference=reference)) is None


def test_figures():
    heights = [0.0, 0.5, 0.2, 2.0, 2.1, 1.9]
    tilts = np.radians([0, 30, 10, 5, 2, 3])
    truth = flown(line(*heights), tilts=tilts, v_WB_B=(1.0, 2.0, 2.0))
    figures = figures_of(truth, settle_time=0.3)
    expected = (0.2 / 3, 0.1, np.radians(30), np.radians(5), 3.0, 0.2, 3.0)
    assert list(figures) == list(FIGURES)
    assert list(figures.values()) == pytest.approx(list(expected), abs=1e-12)


def test_a_vehicle_that_never_flew_has_no_lowest_altitude():
    assert figures_of(flown(line(0.0, 0.0)), settle_time=0.0)["altitude_min_m"] is None


def test_a_flight_that_a_collision_ended_has_crashed():
    scene = Scene([Sphere(p_WO=np.array([0.0, 0.0, 3.0]), radius=0.5)])
    assert crash_of(flown(line(1.0, 1.5, 2.4), scene=scene)) == ("obstacle", 0.2)
    assert crash_of(flown(line(1.0, 0.0, 0.0, 2.9), scene=scene)) == ("ground", 0.1)
