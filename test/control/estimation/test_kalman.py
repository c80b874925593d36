# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The equations of the filter, compared with textbooks and with batch least squares."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from quad_mpc_ros.control.estimation import kalman
from quad_mpc_ros.control.lie import Array

SIZE, MEASURED = 7, 3


def covariance(rng: np.random.Generator, size: int = SIZE) -> Array:
    root = rng.normal(size=(size, size))
    return np.asarray(root @ root.T + 0.1 * np.eye(size))


def test_prediction_matches_the_textbook() -> None:
    rng = np.random.default_rng(0)
    P, F, Q = covariance(rng), rng.normal(size=(SIZE, SIZE)), rng.uniform(size=SIZE)
    expected = F @ P @ F.T + np.diag(Q)
    kalman.predict(P, F, Q)
    np.testing.assert_allclose(P, expected, rtol=1e-12)
    np.testing.assert_array_equal(P, P.T)


def test_update_matches_the_textbook() -> None:
    rng = np.random.default_rng(1)
    P, H, R = covariance(rng), rng.normal(size=(MEASURED, SIZE)), 0.3
    x, nu = rng.normal(size=SIZE), rng.normal(size=MEASURED)
    S = H @ P @ H.T + R * np.eye(MEASURED)
    K = P @ H.T @ np.linalg.inv(S)
    expected_x, expected_P = x + K @ nu, (np.eye(SIZE) - K @ H) @ P
    seen = kalman.innovation(P, H, R, nu)
    assert kalman.squared_distance(seen, 0.0) == pytest.approx(nu @ np.linalg.inv(S) @ nu)
    kalman.update(x, P, seen, np.zeros(SIZE))
    np.testing.assert_allclose(x, expected_x, rtol=1e-10)
    np.testing.assert_allclose(P, expected_P, atol=1e-10)


def test_considered_states_stay_and_their_uncertainty_counts() -> None:
    """Joseph's form for a gain of which rows are zero."""
    rng = np.random.default_rng(2)
    P, H, R = covariance(rng), rng.normal(size=(MEASURED, SIZE)), 0.3
    x, nu = rng.normal(size=SIZE), rng.normal(size=MEASURED)
    considered = np.array([0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 1.0])
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R * np.eye(MEASURED))
    K[considered > 0.0] = 0.0
    left = np.eye(SIZE) - K @ H
    expected = left @ P @ left.T + R * K @ K.T
    before, kept = x.copy(), P[np.ix_(considered > 0.0, considered > 0.0)].copy()
    kalman.update(x, P, kalman.innovation(P, H, R, nu), considered)
    np.testing.assert_allclose(P, expected, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(x, before + K @ nu)
    np.testing.assert_array_equal(x[considered > 0.0], before[considered > 0.0])
    np.testing.assert_allclose(P[np.ix_(considered > 0.0, considered > 0.0)], kept, rtol=1e-12)
    assert np.linalg.eigvalsh(P).min() > 0.0


def test_estimate_matches_batch_least_squares() -> None:
    rng = np.random.default_rng(3)
    truth, P, R = rng.normal(size=SIZE), 4.0 * np.eye(SIZE), 0.2
    x = np.zeros(SIZE)
    information, weighted = np.linalg.inv(P), np.zeros(SIZE)
    for _ in range(30):
        H = rng.normal(size=(MEASURED, SIZE))
        z = H @ truth + np.sqrt(R) * rng.normal(size=MEASURED)
        information, weighted = information + H.T @ H / R, weighted + H.T @ z / R
        kalman.update(x, P, kalman.innovation(P, H, R, z - H @ x), np.zeros(SIZE))
    np.testing.assert_allclose(x, np.linalg.solve(information, weighted), rtol=1e-9)
    np.testing.assert_allclose(P, np.linalg.inv(information), rtol=1e-8, atol=1e-12)


def test_projects_to_the_nearest_point_in_the_norm_of_the_information() -> None:
    rng = np.random.default_rng(4)
    x, P = np.array([2.0, -1.0, 0.5]), covariance(rng, 3)
    # Of all points whose first coordinate is 1, by the conditions of Karush, Kuhn and Tucker.
    W, a = np.linalg.inv(P), np.eye(3)[0]
    system = np.block([[W, a[:, None]], [a[None], np.zeros((1, 1))]])
    expected = np.linalg.solve(system, np.array([*(W @ x), 1.0]))[:3]
    kalman.constrain(x, P, 0, (-1.0, 1.0), np.zeros(3))
    np.testing.assert_allclose(x, expected)


def test_gate_is_a_quantile_of_chi_square() -> None:
    assert pytest.approx(chi2.isf(1e-6, MEASURED), abs=0.01) == kalman.GATE
