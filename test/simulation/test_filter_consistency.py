# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The filter in closed loop on plants that are not its model: NIS and NEES."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from scipy.stats import chi2

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.estimation.delay_compensation import DelayCompensation
from quad_mpc_ros.control.estimation.filter_state import MOTION
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.prediction import PredictedState
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import fly
from quad_mpc_ros.simulation.config import SimulatorConfig

FLIGHTS, SETTLED = 4, 150  # odometries
KINEMATIC = slice(MOTION.position, MOTION.disturbance)


class Seen(NamedTuple):
    """NIS of the position and NEES of the motion at an odometry."""

    position_nis: float
    motion_nees: float


def flown(plant: str, trajectory: str, seed: int, patch: pytest.MonkeyPatch) -> list[Seen]:
    followed, predict = [], DelayCompensation.predict

    def recording(
        self: DelayCompensation, odometry: OdometrySample, *, late_ns: int
    ) -> PredictedState:
        predicted = predict(self, odometry, late_ns=late_ns)
        followed.append(self._estimator.filter.copy())
        return predicted

    patch.setattr(DelayCompensation, "predict", recording)
    simulator = SimulatorConfig(
        plant=plant,
        position_noise=0.01,
        velocity_noise=0.05,
        attitude_noise=0.003,
        rate_noise=0.02,
        gust_intensity=0.5,
        duration=8.0,
        initial_position=(0.0, 0.0, 2.0),
        seed=seed,
    )
    steps = list(
        fly(
            mpc=MpcConfig(),
            simulator=simulator,
            reference=ReferenceConfig(trajectory=trajectory, height=2.0, angular_frequency=1.2),
            on_reference=True,
        )
    )
    found = []
    for step, state in zip(steps, followed[-len(steps) :], strict=True):
        R_WB = so3.rotation_from_quaternion_xyzw(step.truth.q_WB_xyzw)
        truth = np.array([*step.truth.p_WB, *(R_WB @ step.truth.v_WB_B)])
        x, P = state.translation.x, state.translation.P[KINEMATIC, KINEMATIC]
        error = x[KINEMATIC] - truth
        found.append(
            Seen(
                float(state.position_nis),
                float(error @ np.linalg.solve(P, error)),
            )
        )
    return found[SETTLED:]


@pytest.mark.parametrize(
    ("plant", "trajectory"), [("internal", "hover"), ("rotors", "lemniscate")]
)
def test_innovations_and_errors_agree_with_the_covariance(
    plant: str, trajectory: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Averages over flights lie below the 97.5 % bound of chi-square, nine times of ten.

    And are not less than half of what is expected: the noise is that of the filter, the plant and
    the gusts are not, for which it is prepared.
    """
    flights = []
    for seed in range(FLIGHTS):
        with monkeypatch.context() as patch:
            flights.append(flown(plant, trajectory, seed, patch))
    for figure, freedom in (("position_nis", 3), ("motion_nees", 6)):
        every = np.array([[getattr(seen, figure) for seen in flight] for flight in flights])
        average = every.mean(axis=0)
        high = chi2.ppf(0.975, FLIGHTS * freedom) / FLIGHTS
        assert np.mean(average > high) < 0.1, figure
        assert average.mean() > 0.5 * freedom, figure
