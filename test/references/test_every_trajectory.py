# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Every trajectory: values are derivatives of each other, and the vehicle's thrust suffices.

The oracles are finite differences and Newton's law.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quad_mpc_ros.control.lie import Array, so3
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.references.config import TRAJECTORIES, ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.references.trajectory import Trajectory, TrajectorySamples

SECOND = 1_000_000_000
VECTORS = ("p_WB", "v_WB_W", "a_WB_W", "w_WB_W")

CASES: dict[str, dict[str, object]] = {
    # What has no case below is flown as it is.
    **{name: {} for name in TRAJECTORIES if name != "square"},
    "hover": {"yaw": 1.0},
    "waypoints": {"dwell_time": 0.3, "max_acceleration": 6.0},
    "circle": {"circle_speed": 5.0},
    "ellipse": {"ellipse_frequency": 2.0},
    "ellipse to the centre": {"ellipse_frequency": 2.0, "ellipse_heading": "centre", "yaw": 0.3},
    "ellipse along": {"ellipse_frequency": 1.5, "ellipse_heading": "along"},
    "ellipse upright": {"ellipse_plane": "vertical", "ellipse_frequency": 2.0, "drag": 0.4},
    "ellipse over the top": {
        "ellipse_plane": "vertical",
        "ellipse_semi_axes": [2.0, 2.0],
        "ellipse_frequency": 3.5,
        "height": 3.0,
    },
    "lemniscate": {"angular_frequency": 2.0},
    "minimum_snap": {"max_acceleration": 8.0},
    "vertical_loop": {"origin": [1.0, -2.0]},
    "vertical_loop north": {"yaw": np.pi / 2.0, "loop_speed": 6.5},
    "flip": {},
    "flip roll": {"flip_axis": "roll", "yaw": -0.7, "drag": 0.5},
    "excitation": {"yaw": -1.0},
    "excitation quick": {"excitation_duration": 7.0},
    "csv": {},
    "gates": {"gates": "split_s", "file": "", "max_acceleration": 5.0},
}
PERIODIC = ("hover", "circle", "ellipse", "lemniscate")
ENDING = [case for case in CASES if case.split()[0] not in PERIODIC]


def spiral(seconds: Array) -> Array:
    angle = 1.5 * seconds
    return np.column_stack((np.cos(angle), np.sin(angle), 1.0 + 0.2 * seconds))


def table(folder: Path) -> Path:
    lines = ["time [s], x [m], y [m], z [m], yaw [rad]"]
    for time in np.arange(0.0, 4.01, 0.1):
        x, y, z = spiral(np.array([time]))[0]
        lines.append(f"{time:.3f}, {x:.4f}, {y:.4f}, {z:.4f}, {1.5 * time:.4f}")
    file = folder / "spiral.csv"
    file.write_text("\n".join(lines))
    return file


@pytest.fixture(scope="module")
def make(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Trajectory]:
    file = table(tmp_path_factory.mktemp("table"))

    def made(case: str) -> Trajectory:
        changes = {"trajectory": case.split()[0], "file": str(file), **CASES[case]}
        return configured_trajectory(ReferenceConfig.build(changes))

    return made


def rotations(samples: TrajectorySamples) -> Array:
    return so3.rotation_from_quaternion_xyzw(samples.q_WB_xyzw)


def test_every_name_has_a_case() -> None:
    assert {case.split()[0] for case in CASES} | {"square"} == set(TRAJECTORIES)


@pytest.mark.parametrize("case", CASES)
def test_each_value_is_the_derivative_of_the_previous(
    case: str, make: Callable[[str], Trajectory]
) -> None:
    trajectory, h = make(case), 50_000
    times = np.linspace(2 * h, max(trajectory.period_ns, SECOND) - 2 * h, 301).astype(int).tolist()
    now = trajectory.at(times)
    before, after = trajectory.at([t - h for t in times]), trajectory.at([t + h for t in times])
    for value, rate in (("p_WB", "v_WB_W"), ("v_WB_W", "a_WB_W")):
        slope = (getattr(after, value) - getattr(before, value)) / (2e-9 * h)
        assert_allclose(slope, getattr(now, rate), atol=2e-4)
    turn = so3.log(rotations(after) @ np.swapaxes(rotations(before), -1, -2)) / (2e-9 * h)
    assert_allclose(turn, now.w_WB_W, atol=2e-3)


@pytest.mark.parametrize("case", CASES)
def test_force_is_along_body_z_and_within_the_thrust_of_the_vehicle(
    case: str, make: Callable[[str], Trajectory]
) -> None:
    trajectory, vehicle = make(case), Vehicle(drag=float(CASES[case].get("drag", 0.2)))
    end_ns = max(trajectory.period_ns, SECOND)
    samples = trajectory.at(list(range(0, end_ns, 2_000_000)))
    specific_force = samples.a_WB_W + vehicle.drag * samples.v_WB_W + [0.0, 0.0, vehicle.gravity]
    force_B = vehicle.mass * np.einsum("nij,ni->nj", rotations(samples), specific_force)
    assert_allclose(force_B[:, :2], 0.0, atol=1e-9)
    for thrust in force_B[:, 2].tolist():
        assert 0.0 <= vehicle.throttle_for(thrust) <= 1.0


@pytest.mark.parametrize("case", ENDING)
def test_starts_and_ends_at_rest_and_level(case: str, make: Callable[[str], Trajectory]) -> None:
    trajectory = make(case)
    end = trajectory.period_ns
    outside = trajectory.at([-(10**15), -1, end + 1, 10**15])
    inside = trajectory.at([0, 0, end - 1, end - 1])
    for name in ("v_WB_W", "a_WB_W", "w_WB_W"):
        assert_array_equal(getattr(outside, name), np.zeros((4, 3)))
        assert_allclose(getattr(inside, name), np.zeros((4, 3)), atol=1e-4)
    assert_allclose(outside.p_WB, inside.p_WB, atol=1e-8)
    assert_allclose(rotations(outside), rotations(inside), atol=1e-6)
    assert_allclose(rotations(outside)[:, 2], np.tile([0.0, 0.0, 1.0], (4, 1)), atol=1e-6)
    assert trajectory.jumps(-SECOND, end + SECOND) == []


@pytest.mark.parametrize("case", CASES)
def test_motion_is_continuous(case: str, make: Callable[[str], Trajectory]) -> None:
    """Finely stepped, everything changes by little, acceleration and body rates included."""
    trajectory = make(case)
    step = 500_000
    samples = trajectory.at(list(range(0, max(trajectory.period_ns, SECOND), step)))
    for name, bound in zip(VECTORS, (0.008, 0.04, 0.3, 0.3), strict=True):
        assert np.abs(np.diff(getattr(samples, name), axis=0)).max() < bound, name
    turns = so3.log(np.swapaxes(rotations(samples)[:-1], -1, -2) @ rotations(samples)[1:])
    fastest = np.linalg.norm(samples.w_WB_W, axis=1).max()
    assert np.linalg.norm(turns, axis=1).max() <= 1.01e-9 * step * fastest + 1e-9
