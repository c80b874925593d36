# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Consistency of the covariance, over flights whose truth is drawn as the filter assumes.

Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, 5.4:
errors and innovations, normalised and averaged over flights, lie within bounds of chi-square.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
import pytest
from fixtures.records import changed, state_of
from scipy.stats import chi2

from quad_mpc_ros.control.estimation import filter_state, measurement_noise
from quad_mpc_ros.control.estimation.command_history import Acting
from quad_mpc_ros.control.estimation.ekf import VehicleEkf, update
from quad_mpc_ros.control.estimation.filter_state import MOTION, Filter
from quad_mpc_ros.control.estimation.update_mode import UpdateMode
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.control.model.parameters import parameters_of
from quad_mpc_ros.control.model.rollout import Body, propagated
from quad_mpc_ros.control.model.vehicle import ActuatorLags, Vehicle

FLIGHTS, STEPS, PERIOD = 24, 400, 0.02
SETTLED = 150  # steps: until then the noise is not known
KINEMATIC = slice(MOTION.position, MOTION.disturbance)
LEARNED = slice(MOTION.disturbance, MOTION.lag)


class Consistency(NamedTuple):
    """Normalised squares of each flight over time (n, m)."""

    position_nis: Array
    motion_nees: Array
    learned_nees: Array


def gauss_markov(rng: np.random.Generator, value: Array, deviation: float, time: float) -> Array:
    kept = math.exp(-PERIOD / time)
    fresh = deviation * math.sqrt(1.0 - kept**2) * rng.normal(size=value.shape)
    return np.asarray(kept * value + fresh)


def flown(seed: int, drift: float) -> list[tuple[float, ...]]:
    rng = np.random.default_rng([seed, 7])
    vehicle = Vehicle()
    nominal = parameters_of(vehicle, ActuatorLags(rate=0.05, thrust=0.04))[()]
    state = Filter.zeros()[()]
    ekf = VehicleEkf(nominal, throttle=vehicle.hover_throttle, delay=0.05, state=state)
    walk, vertical_time = filter_state.DISTURBANCE.random_walk, filter_state.VERTICAL_TIME
    vertical = filter_state.VERTICAL.random_walk * math.sqrt(vertical_time / 2.0)
    scale = 1.0 + filter_state.SCALE.initial * float(np.clip(rng.normal(), -2.0, 2.0))
    d = np.array([*rng.normal(size=2), vertical * rng.normal()])
    b = drift * rng.normal(size=3)
    body = Body(
        (0.0,) * 3,
        (0.0,) * 3,
        tuple(np.eye(3).ravel()),
        (vehicle.hover_throttle,) + (0.0,) * 3,
        (0.0,) * 3,
    )
    phases, found = rng.uniform(0.0, 2.0 * math.pi, 3), []
    measured = state_of(v_WB_W=b)
    ekf.start(p_WB=np.zeros(3), v_WB_W=b, w_WB_B=np.zeros(3))
    for k in range(STEPS):
        t = k * PERIOD
        w = tuple(np.array([0.8, 0.7, 0.3]) * np.cos(np.array([2.1, 2.7, 1.3]) * t + phases))
        throttle = vehicle.hover_throttle / math.sqrt(scale) + 0.06 * math.sin(4.0 * t + phases[0])
        command = (throttle, *w)
        d[:2] += walk * math.sqrt(PERIOD) * rng.normal(size=2)
        d[2:] = gauss_markov(rng, d[2:], vertical, vertical_time)
        b = gauss_markov(rng, b, drift, 1.0)
        model = changed(nominal, a_W=d, thrust_scale=scale, rate_time_constants=0.0)
        body = propagated(model, command, PERIOD, body._replace(actuators=(body.actuators[0], *w)))
        moved = np.array(body.v) + 0.1 * math.sqrt(PERIOD) * rng.normal(size=3)
        body = body._replace(v=tuple(moved))
        before, measured = (
            measured,
            state_of(
                p_WB=np.array(body.p) + measurement_noise.LEAST_OF_POSITION * rng.normal(size=3),
                v_WB_W=moved + b + measurement_noise.USUAL * rng.normal(size=3),
                R_WB=np.array(body.R).reshape(3, 3),
                actuators=[0.0, *w],
            ),
        )
        acting = Acting(durations=np.array([PERIOD]), commands=np.array([command]))
        mode = update(state, before, measured, acting, UpdateMode.LEARN, 0.0)
        assert mode == UpdateMode.LEARN
        x, P = state.translation.x, state.translation.P
        motion = x[KINEMATIC] - np.array([*body.p, *body.v])
        learned = x[LEARNED] - np.array([*d, scale])
        found.append(
            (
                float(state.position_nis),
                float(motion @ np.linalg.solve(P[KINEMATIC, KINEMATIC], motion)),
                float(learned @ np.linalg.solve(P[LEARNED, LEARNED], learned)),
            )
        )
    return found


@functools.cache
def flights(drift: float) -> Consistency:
    every = np.array([flown(seed, drift) for seed in range(FLIGHTS)])[:, SETTLED:]
    return Consistency(*np.moveaxis(every, 2, 0))


@pytest.mark.parametrize("drift", [0.0, 0.3])
@pytest.mark.parametrize(
    ("figure", "freedom"),
    [("position_nis", 3), ("motion_nees", 6), ("learned_nees", 4)],
)
def test_averages_lie_within_bounds_of_chi_square(figure: str, freedom: int, drift: float) -> None:
    """The bounds are of 95 %; the covariance is at most a third too large on average."""
    average = getattr(flights(drift), figure).mean(axis=0)
    _low, high = chi2.interval(0.95, FLIGHTS * freedom)
    too_certain = np.mean(average > high / FLIGHTS)
    assert too_certain < 0.1
    assert average.mean() > 0.66 * freedom


@pytest.mark.parametrize("drift", [0.0, 0.3])
def test_confidence_intervals_contain_the_truth(drift: float) -> None:
    nees = flights(drift).learned_nees
    for probability in (0.5, 0.9):
        held = np.mean(nees < chi2.ppf(probability, 4))
        assert held > probability - 0.1
