"""What the estimator learns from exact motions, and what it must not learn."""

from __future__ import annotations

import numpy as np
import pytest

from quad_mpc_ros.estimation.command_history import Acting
from quad_mpc_ros.estimation.disturbance_ekf import VehicleEstimator
from quad_mpc_ros.lie import Array, so3
from quad_mpc_ros.model.rollout import Model, model_of
from quad_mpc_ros.model.state import Input, State
from quad_mpc_ros.model.vehicle import Vehicle
from quad_mpc_ros.simulation.dynamics import integrate, rigid_body_dynamics

VEHICLE = Vehicle()
PERIOD, FINE = 0.02, 20


def model(*, rate: float = 0.0, thrust: float = 0.0) -> Model:
    return model_of(VEHICLE, rate_time_constant=rate, thrust_time_constant=thrust)


def command(seconds: float) -> Input:
    """Return a command of a vehicle that swings about hover."""
    return Input(
        throttle=0.29 + 0.12 * np.sin(7.0 * seconds) + 0.1 * np.sin(3.1 * seconds),
        w_WB_B=np.array(
            [
                2.0 * np.cos(4.0 * seconds),
                1.5 * np.cos(2.6 * seconds) + np.sin(9.0 * seconds),
                np.sin(5.0 * seconds),
            ]
        ),
    )


def under(u: Input) -> Acting:
    """Return what acts under one command over a period."""
    return Acting(durations=np.array([PERIOD]), commands=u.vector()[None])


def flown(
    estimator: VehicleEstimator,
    *,
    rate: float = 0.0,
    thrust: float = 0.0,
    scale: float = 1.0,
    a_W: Array | None = None,
    frozen: bool = False,
    noise: float = 0.0,
) -> VehicleEstimator:
    """Let the estimator follow a flight, integrated in fine steps by the true rigid body."""
    rng = np.random.default_rng(3)
    x = State(p_WB=np.zeros(3), v_WB_B=np.zeros(3), R_WB=np.eye(3))
    acting = np.concatenate(([0.29], np.zeros(3)))
    lags = np.array([thrust, rate, rate, rate])
    estimator.start(x.v_WB_W)
    for k in range(500):
        u, before, w_before = command(k * PERIOD), x, acting[1:].copy()
        for _ in range(FINE):
            dt = PERIOD / FINE
            decay = np.exp(-dt / np.maximum(lags, 1e-12))
            half = np.sqrt(decay)
            acting, middle = (
                u.vector() + decay * (acting - u.vector()),
                u.vector() + half * (acting - u.vector()),
            )
            # A stronger thrust is one more of the motors' curve.
            s = middle[0]
            force = scale * VEHICLE.thrust(s)
            held = Input(throttle=VEHICLE.throttle_for(force), w_WB_B=middle[1:])
            x = integrate(x, held, VEHICLE, dynamics=rigid_body_dynamics, duration=dt)
            if a_W is not None:
                pushed = x.v_WB_W + dt * a_W
                x = State(p_WB=x.p_WB, v_WB_B=x.R_WB.T @ pushed, R_WB=x.R_WB)
        estimator.follow(
            R_before=before.R_WB,
            w_before=w_before,
            R_after=x.R_WB,
            w_after=acting[1:] + noise * rng.normal(size=3),
            v_after=x.v_WB_W + noise * rng.normal(size=3),
            acting=under(u),
            frozen=frozen,
        )
    return estimator


@pytest.mark.parametrize("scale", [0.8, 1.0, 1.1])
def test_wind_and_thrust_scale_are_told_apart(scale: float) -> None:
    wind = np.array([0.6, -0.4, 0.2])
    estimator = VehicleEstimator(model(), throttle=0.29, learning=True)
    estimate = flown(estimator, scale=scale, a_W=wind).disturbance
    np.testing.assert_allclose(estimate.a_W, wind, atol=0.1)
    assert estimate.thrust_scale == pytest.approx(scale, abs=0.01)


@pytest.mark.parametrize(("rate", "thrust"), [(0.03, 0.03), (0.045, 0.045), (0.02, 0.055)])
def test_time_constants_are_found(rate: float, thrust: float) -> None:
    estimator = VehicleEstimator(model(rate=0.03, thrust=0.03), throttle=0.29, learning=True)
    learned = flown(estimator, rate=rate, thrust=thrust, scale=0.9).model
    assert learned.rate_time_constant == pytest.approx(rate, rel=0.02)
    assert learned.thrust_time_constant == pytest.approx(thrust, rel=0.1)
    assert estimator.disturbance.thrust_scale == pytest.approx(0.9, abs=0.02)
    assert estimator.throttle == pytest.approx(_lagging(thrust), abs=0.01)


def test_noise_costs_accuracy_only() -> None:
    estimator = VehicleEstimator(model(rate=0.03, thrust=0.03), throttle=0.29, learning=True)
    learned = flown(estimator, rate=0.045, thrust=0.045, noise=0.03).model
    assert learned.rate_time_constant == pytest.approx(0.045, rel=0.1)
    assert learned.thrust_time_constant == pytest.approx(0.045, rel=0.3)


def test_without_lags_in_the_model_none_are_learned() -> None:
    estimator = VehicleEstimator(model(), throttle=0.29, learning=True)
    learned = flown(estimator, rate=0.02, thrust=0.02).model
    assert learned.rate_time_constant == learned.thrust_time_constant == 0.0


def test_frozen_it_learns_nothing() -> None:
    modelled = model(rate=0.03, thrust=0.03)
    estimator = VehicleEstimator(modelled, throttle=0.29, learning=True)
    flown(estimator, rate=0.05, thrust=0.05, scale=0.8, frozen=True)
    assert estimator.model == modelled
    assert not estimator.disturbance.a_W.any()
    assert estimator.disturbance.thrust_scale == 1.0


def test_on_the_ground_it_learns_nothing() -> None:
    modelled = model(rate=0.03, thrust=0.03)
    estimator = VehicleEstimator(modelled, throttle=0.0, learning=True)
    estimator.start(np.zeros(3))
    turning = Input(throttle=0.2, w_WB_B=np.array([3.0, 0.0, 0.0]))
    for _ in range(200):
        estimator.follow(
            R_before=np.eye(3),
            w_before=np.zeros(3),
            R_after=np.eye(3),
            w_after=np.zeros(3),
            v_after=np.zeros(3),
            acting=under(turning),
            frozen=False,
        )
    assert estimator.model == modelled
    assert not estimator.disturbance.a_W.any()
    assert estimator.disturbance.thrust_scale == 1.0


def test_after_a_landing_it_keeps_what_it_learned() -> None:
    wind = np.array([0.6, -0.4, 0.2])
    estimator = VehicleEstimator(model(), throttle=0.29, learning=True)
    before = flown(estimator, a_W=wind).disturbance
    idle = Input(throttle=0.0, w_WB_B=np.zeros(3))
    for _ in range(200):
        estimator.follow(
            R_before=np.eye(3),
            w_before=np.zeros(3),
            R_after=np.eye(3),
            w_after=np.zeros(3),
            v_after=np.zeros(3),
            acting=under(idle),
            frozen=False,
        )
    np.testing.assert_array_equal(estimator.disturbance.a_W, before.a_W)
    assert estimator.disturbance.thrust_scale == before.thrust_scale


def test_little_thrust_at_rest_is_a_landing_only_when_it_lasts() -> None:
    """For a moment it is a vehicle in the air that has more thrust than modelled."""
    scale, hover = 1.5, VEHICLE.thrust(VEHICLE.hover_throttle)
    estimator = VehicleEstimator(model(), throttle=0.29, learning=True)
    estimator.start(np.zeros(3))
    velocity = 0.0
    # Thrust as modelled over the weight: taken over in the air, and brought to hover.
    for modelled in (1.0, 0.55, 0.55, *(1.0 / scale for _ in range(200))):
        velocity += PERIOD * VEHICLE.gravity * (scale * modelled - 1.0)
        assert modelled == 1.0 or abs(velocity) < 0.1
        throttle = VEHICLE.throttle_for(modelled * hover)
        estimator.follow(
            R_before=np.eye(3),
            w_before=np.zeros(3),
            R_after=np.eye(3),
            w_after=np.zeros(3),
            v_after=np.array([0.0, 0.0, velocity]),
            acting=under(Input(throttle=throttle, w_WB_B=np.zeros(3))),
            frozen=False,
        )
    d = estimator.disturbance
    assert d.thrust_scale / scale * VEHICLE.gravity + d.a_W[2] == pytest.approx(
        VEHICLE.gravity, rel=0.01
    )


def test_estimates_are_bounded() -> None:
    """However absurd the velocities, and the rates."""
    estimator = VehicleEstimator(model(rate=0.03, thrust=0.03), throttle=0.29, learning=True)
    rng = np.random.default_rng(0)
    for k in range(500):
        estimator.follow(
            R_before=so3.exp(rng.normal(size=3)),
            w_before=20.0 * rng.normal(size=3),
            R_after=so3.exp(rng.normal(size=3)),
            w_after=20.0 * rng.normal(size=3),
            v_after=np.full(3, 1.0 * k),
            acting=under(command(0.1 * k)),
            frozen=False,
        )
        learned, disturbance = estimator.model, estimator.disturbance
        assert np.abs(disturbance.a_W).max() <= 5.0
        assert 0.5 <= disturbance.thrust_scale <= 1.5
        assert 0.015 <= learned.rate_time_constant <= 0.06
        assert 0.015 <= learned.thrust_time_constant <= 0.06


def _lagging(time_constant: float) -> float:
    """Return the throttle at the end of the flight behind a lag."""
    decay, s = np.exp(-PERIOD / time_constant), 0.29
    for k in range(500):
        s = command(k * PERIOD).throttle + decay * (s - command(k * PERIOD).throttle)
    return float(s)
