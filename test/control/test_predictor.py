"""Which command acts when, and the state in which the next one will."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import trapezoid

from quad_mpc_ros.control.actuators import ActuatorLag, CommandHistory, Interval
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.disturbance import DisturbanceEstimator
from quad_mpc_ros.control.predictor import StatePredictor
from quad_mpc_ros.core import so3
from quad_mpc_ros.core.messages import OdometrySample
from quad_mpc_ros.core.state import Input
from quad_mpc_ros.core.vehicle import Vehicle

MS = 1_000_000


def throttle(value: float) -> Input:
    return Input(throttle=value, w_WB_B=np.zeros(3))


def test_commands_act_after_the_delay_and_until_the_next() -> None:
    history = CommandHistory(delay_ns=25 * MS, initial=throttle(0.3))
    history.record(throttle(0.5), sent_ns=0)
    history.record(throttle(0.7), sent_ns=20 * MS)
    acting = [
        (round(interval.duration * 1e3, 6), interval.command.throttle)
        for interval in history.between(10 * MS, 60 * MS)
    ]
    assert acting == [(15.0, 0.3), (20.0, 0.5), (15.0, 0.7)]


def test_the_intervals_fill_the_time_whatever_was_sent() -> None:
    rng = np.random.default_rng(0)
    history = CommandHistory(delay_ns=13 * MS, initial=throttle(0.3))
    for stamp in np.cumsum(rng.integers(1, 40, 50)) * MS:
        history.record(throttle(float(rng.random())), sent_ns=int(stamp))
    for start in range(0, 900, 37):
        total = sum(i.duration for i in history.between(start * MS, (start + 31) * MS))
        assert total == pytest.approx(0.031, abs=1e-12)


def test_lag_is_the_step_response_of_first_order() -> None:
    lag = ActuatorLag(rate=0.05, thrust=0.04)
    end, mean = lag.throttle(0.0, Interval(duration=0.04, command=throttle(1.0)))
    assert end == pytest.approx(1.0 - np.exp(-1.0))
    times = np.linspace(0.0, 0.04, 100_001)
    assert mean == pytest.approx(trapezoid(1.0 - np.exp(-times / 0.04), times) / 0.04)


def test_without_delay_the_situation_is_the_odometry() -> None:
    predictor = StatePredictor(MpcConfig())
    odometry = _odometry(stamp_ns=20 * MS)
    situation = predictor.predict(odometry)
    assert situation.stamp_ns == 20 * MS
    np.testing.assert_array_equal(situation.x.p_WB, odometry.p_WB)
    np.testing.assert_array_equal(situation.x.v_WB_B, odometry.v_WB_B)


def test_free_fall_across_the_delay() -> None:
    """With the motors off for long enough, the state ahead is that of a stone."""
    config = MpcConfig(input_delay=0.033, drag=0.0, thrust_curve=(1.88, 2.8, 0.0))
    predictor = StatePredictor(config)
    predictor.record(throttle(0.0), sent_ns=-100 * MS)
    situation = predictor.predict(_odometry(stamp_ns=0, v_WB_B=np.array([1.0, 0.0, 0.0])))
    assert situation.stamp_ns == 33 * MS
    np.testing.assert_allclose(
        situation.x.p_WB, [0.033, 0.0, 5.0 - 0.5 * 9.81 * 0.033**2], atol=1e-9
    )
    np.testing.assert_allclose(situation.x.v_WB_W, [1.0, 0.0, -9.81 * 0.033], atol=1e-9)


def test_rates_in_flight_turn_the_state_ahead() -> None:
    predictor = StatePredictor(MpcConfig(input_delay=0.03))
    predictor.record(Input(throttle=0.3, w_WB_B=np.array([0.0, 0.0, 2.0])), sent_ns=-10 * MS)
    situation = predictor.predict(_odometry(stamp_ns=0))
    # Sent 10 ms ago with a delay of 30 ms: it acts for the last 10 ms of the 30 ahead.
    np.testing.assert_allclose(so3.log(situation.x.R_WB), [0.0, 0.0, 2.0 * 0.010], atol=1e-12)


@pytest.mark.parametrize("scale", [0.8, 1.0, 1.1])
def test_estimator_finds_wind_and_thrust_scale(scale: float) -> None:
    """Fed with exact motion of a tilting vehicle, it tells the one from the other."""
    vehicle = Vehicle()
    estimator = DisturbanceEstimator(vehicle)
    wind = np.array([0.6, -0.4, 0.0])
    v, dt = np.zeros(3), 0.02
    for k in range(1000):
        t = k * dt
        axis = so3.exp([0.5 * np.sin(2.0 * t), 0.5 * np.cos(1.3 * t), 0.0])[:, 2]
        thrust = vehicle.mass * (9.81 + 2.0 * np.sin(3.0 * t))
        push = scale * thrust / vehicle.mass * axis
        v = v + dt * (push + wind - vehicle.drag * v + np.array([0.0, 0.0, -9.81]))
        estimator.update(v_WB_W=v, thrust_axis_W=axis, thrust=thrust, duration=dt, frozen=False)
    estimate = estimator.estimate
    np.testing.assert_allclose(estimate.a_W, wind, atol=0.15)
    assert estimate.thrust_scale == pytest.approx(scale, abs=0.02)


def test_estimator_learns_nothing_on_the_ground_or_frozen() -> None:
    vehicle = Vehicle()
    up = np.array([0.0, 0.0, 1.0])
    for thrust, v, frozen in ((0.0, np.zeros(3), False), (6.0, np.array([3.0, 0, 0]), True)):
        estimator = DisturbanceEstimator(vehicle)
        for _ in range(200):
            estimator.update(
                v_WB_W=v, thrust_axis_W=up, thrust=thrust, duration=0.02, frozen=frozen
            )
        assert not estimator.estimate.a_W.any()
        assert estimator.estimate.thrust_scale == 1.0


def test_estimate_is_bounded() -> None:
    estimator = DisturbanceEstimator(Vehicle())
    up = np.array([0.0, 0.0, 1.0])
    for k in range(500):
        v = np.array([1.0, 1.0, 1.0]) * k
        estimator.update(v_WB_W=v, thrust_axis_W=up, thrust=3.9, duration=0.02, frozen=False)
    assert np.abs(estimator.estimate.a_W).max() <= 5.0
    assert 0.5 <= estimator.estimate.thrust_scale <= 1.5


def _odometry(*, stamp_ns: int, v_WB_B: np.ndarray | None = None) -> OdometrySample:
    return OdometrySample(
        stamp_ns=stamp_ns,
        p_WB=np.array([0.0, 0.0, 5.0]),
        q_WB_xyzw=np.array([0.0, 0.0, 0.0, 1.0]),
        v_WB_B=np.zeros(3) if v_WB_B is None else v_WB_B,
        w_WB_B=np.zeros(3),
    )
