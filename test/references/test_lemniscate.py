"""The lemniscate: its path, its dynamics, and its published windows."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.reference_window import ReferencePoints, sample
from quad_mpc_ros.control.model.target import reference_input
from quad_mpc_ros.control.model.vehicle import Vehicle
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.references.server import ReferenceServer
from quad_mpc_ros.references.trajectory import TrajectorySamples

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
FAST = 2.6


def config(**changes: object) -> ReferenceConfig:
    return ReferenceConfig.build({"trajectory": "lemniscate", **changes})


def rotations(samples: TrajectorySamples) -> np.ndarray:
    return so3.rotation_from_quaternion_xyzw(samples.q_WB_xyzw)


def points(samples: TrajectorySamples) -> list[ReferencePoints]:
    """Return the samples one by one, as a controller reads them."""
    return [
        ReferencePoints(p_WB=p, R_WB=R, v_WB_W=v, a_WB_W=a.copy(), w_WB_B=R.T @ w)
        for p, R, v, a, w in zip(
            samples.p_WB,
            rotations(samples),
            samples.v_WB_W,
            samples.a_WB_W,
            samples.w_WB_W,
            strict=True,
        )
    ]


def test_shape_height_and_origin() -> None:
    eight = configured_trajectory(config(origin=[1.0, -2.0], height=3.0))
    period = eight.period_ns
    assert period == round(2e9 * np.pi)
    eighths = eight.at([period * part // 8 for part in range(9)]).p_WB - [1.0, -2.0, 3.0]
    s = 3.0 * np.sqrt(0.5)
    expected = [
        [0, 0, 0],
        [s, 1.5, 0],
        [3, 0, 0],
        [s, -1.5, 0],
        [0, 0, 0],
        [-s, 1.5, 0],
        [-3, 0, 0],
        [-s, -1.5, 0],
        [0, 0, 0],
    ]
    assert_allclose(eighths, expected, atol=1e-7)


def test_it_goes_on_into_the_next_round() -> None:
    eight = configured_trajectory(config(angular_frequency=FAST))
    period = eight.period_ns
    assert eight.jumps(0, 100 * period) == []
    again, first = eight.at([period + 12345]), eight.at([12345])
    for name in ("p_WB", "q_WB_xyzw", "v_WB_W", "a_WB_W", "w_WB_W"):
        assert_allclose(getattr(again, name), getattr(first, name), atol=1e-6)


def test_its_throttle_is_within_reach_of_the_papers_vehicle_at_11_m_per_s() -> None:
    eight = configured_trajectory(config(angular_frequency=FAST))
    samples = eight.at(list(range(0, eight.period_ns, 5_000_000)))
    assert np.linalg.norm(samples.v_WB_W, axis=1).max() == pytest.approx(11.03, abs=0.01)
    vehicle = Vehicle()
    for point in points(samples):
        force = point.a_WB_W + vehicle.drag * point.v_WB_W + [0.0, 0.0, vehicle.gravity]
        # Along body z alone, and below what the motors have: reference_input clips nothing.
        assert_allclose(np.cross(point.R_WB[:, 2], force), np.zeros(3), atol=1e-9)
        throttle = reference_input(point, vehicle).throttle
        assert 0.0 < throttle < 1.0
        assert vehicle.thrust(throttle) == pytest.approx(
            vehicle.mass * float(np.linalg.norm(force))
        )


def test_before_its_start_it_rests_level_where_it_begins() -> None:
    eight = configured_trajectory(config(angular_frequency=FAST))
    samples = eight.at([-(10**19), -1, 0])
    assert_array_equal(samples.p_WB, np.tile([0.0, 0.0, 2.0], (3, 1)))
    assert_array_equal(samples.q_WB_xyzw[:2], np.tile([0.0, 0.0, 0.0, 1.0], (2, 1)))
    for name in ("v_WB_W", "a_WB_W", "w_WB_W"):
        assert_array_equal(getattr(samples, name)[:2], np.zeros((2, 3)))
    assert_allclose(samples.v_WB_W[2], [3.0 * FAST, 3.0 * FAST, 0.0])
    assert eight.jumps(-SECOND, SECOND) == [0]
    assert eight.jumps(-SECOND, -1) == eight.jumps(0, SECOND) == []
    assert_array_equal(eight.at([-1]).v_WB_W, np.zeros((1, 3)))


def server(**changes: object) -> ReferenceServer:
    return ReferenceServer(config(**changes))


def test_a_window_from_before_the_start_waits_for_it() -> None:
    waiting = server(angular_frequency=FAST)
    waiting.start(START)
    window = waiting.window(START - SECOND // 3)
    resting, moving = sample(window, START - 1), sample(window, START)
    assert_allclose(resting.p_WB, [0.0, 0.0, 2.0])
    assert_allclose(resting.v_WB_W, np.zeros(3))
    assert_allclose(moving.v_WB_W, [3.0 * FAST, 3.0 * FAST, 0.0])


@pytest.mark.parametrize("preview", [False, True])
@pytest.mark.parametrize("frequency", [1.0, FAST])
def test_published_windows_reproduce_the_trajectory(preview: bool, frequency: float) -> None:
    changes = {"angular_frequency": frequency, "preview": preview}
    eight, started = configured_trajectory(config(**changes)), server(**changes)
    started.start(START)
    for begin in (0, 123_456_789):
        window = started.window(START + begin)
        assert len(window.offset_ns) == 41
        times = list(range(begin, begin + int(window.offset_ns[-1]), 1_000_003))
        read, true = sample(window, START + np.array(times)), eight.at(times)
        R_error = np.swapaxes(rotations(true), -1, -2) @ read.R_WB
        assert np.linalg.norm(read.p_WB - true.p_WB, axis=1).max() < 1e-4
        assert np.linalg.norm(read.v_WB_W - true.v_WB_W, axis=1).max() < 1e-3
        # Between samples these are straight lines, which closed loops do not notice.
        assert np.linalg.norm(so3.log(R_error), axis=1).max() < 0.1
        assert np.linalg.norm(read.a_WB_W - true.a_WB_W, axis=1).max() < 0.4


def test_the_whole_is_drawn_once_round_and_closes() -> None:
    whole = server().whole()
    steps = np.linalg.norm(np.diff(whole.p_WB, axis=0), axis=1)
    assert steps.max() < 0.05 * np.linalg.norm(whole.v_WB_W, axis=1).max()
    assert_allclose(whole.p_WB[-1], whole.p_WB[0], atol=1e-7)
    assert steps.sum() == pytest.approx(18.3, abs=0.1)
    assert len(server(angular_frequency=0.001).whole().p_WB) < 11_000


@pytest.mark.parametrize(
    "changes",
    [
        {"angular_frequency": 3.5},
        {"angular_frequency": 1e200},
        {"amplitude_x": 1e300},
        {"amplitude_y": 20.0},
        {"mass": 1.8},
        # Without weight or drag, straight through the origin there is no force to thrust against.
        {"gravity": 1e-6, "drag": 0.0, "mass": 1e5, "amplitude_y": 0.0},
    ],
)
def test_refuses_an_infeasible_lemniscate(changes: dict[str, float]) -> None:
    with pytest.raises(
        ConfigurationError, match=r"^reference\.trajectory: given 'lemniscate'"
    ) as error:
        server(**changes)
    assert "\n" not in str(error.value)


def test_one_place_is_flown_as_a_hover() -> None:
    eight = configured_trajectory(config(amplitude_x=0.0, amplitude_y=0.0)).at([0, SECOND])
    assert_array_equal(eight.p_WB, np.tile([0.0, 0.0, 2.0], (2, 1)))
    assert_allclose(rotations(eight), np.tile(np.eye(3), (2, 1, 1)), atol=1e-15)
