# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The Kalman filter, compiled: predict, gate, update; consider and constrain.

    predict   P <- F P F' + Q
    gate      nu = z - h(x),  S = H P H' + R,  nu' S^-1 nu <= the chi-square quantile
    update    K = P H' S^-1,  x <- x + K nu,  P <- (I - K H) P (I - K H)' + K R K'

The update is in Joseph's form, which holds for any K, so that rows of K may be zero: states that
must not be updated are *considered* (Schmidt, "Application of state-space methods to navigation
problems", 1966). Considered states do not change, but their uncertainty counts in S. A state
beyond a bound is projected back in the norm of P^-1 (Simon, Chia, "Kalman filtering with state
equality constraints", 2002), which moves correlated states as well.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels

GATE = 30.66
"""Quantile of chi-square with 3 degrees of freedom, exceeded by one innovation in a million."""


class Innovation(NamedTuple):
    """Innovation nu (3,), its covariance S (3, 3), and P H' (n, 3)."""

    nu: Array
    S: Array
    PHt: Array


@compiled
def predict(P: Array, F: Array, Q: Array) -> None:
    """Propagate a covariance (n, n) by F (n, n), sparse, and noise of variances Q (n,)."""
    carried = product(F, np.ascontiguousarray(product(F, P).T))
    for i in range(len(P)):
        for j in range(i):
            P[i, j] = P[j, i] = 0.5 * (carried[i, j] + carried[j, i])
        P[i, i] = carried[i, i] + Q[i]


@compiled
def innovation(P: Array, H: Array, R: float, nu: Array) -> Innovation:
    """Return the innovation nu (3,) by H (3, n), sparse, and noise of variance R on each axis."""
    HP = product(H, P)
    S = product(H, HP.T)
    for k in range(len(S)):
        S[k, k] += R
    return Innovation(nu, S, HP.T)


@compiled
def squared_distance(measured: Innovation, extra_variance: float) -> float:
    """Return nu' S^-1 nu, the normalised innovation squared, with a variance added to S."""
    S, square = measured.S.copy(), 0.0
    for k in range(3):
        S[k, k] += extra_variance
    inverted = inverse(S)
    for i in range(3):
        for j in range(3):
            square += measured.nu[i] * inverted[i, j] * measured.nu[j]
    return square


@compiled
def update(x: Array, P: Array, measured: Innovation, considered: Array) -> None:
    """Correct by an innovation; states (n,) with non-zero ``considered`` are not changed."""
    PHt, S, inverted, n = measured.PHt, measured.S, inverse(measured.S), len(x)
    K, KS = np.zeros((n, 3)), np.zeros((n, 3))
    for i in range(n):
        if considered[i] == 0.0:
            for k in range(3):
                K[i, k] = PHt[i, 0] * inverted[0, k] + PHt[i, 1] * inverted[1, k]
                K[i, k] += PHt[i, 2] * inverted[2, k]
                x[i] += K[i, k] * measured.nu[k]
            for k in range(3):
                KS[i, k] = K[i, 0] * S[0, k] + K[i, 1] * S[1, k] + K[i, 2] * S[2, k]
    # Joseph's form, with H P = (P H')' and S = H P H' + R: P - K H P - P H' K' + K S K'.
    for i in range(n):
        for j in range(i + 1):
            change = 0.0
            for k in range(3):
                change += (KS[i, k] - PHt[i, k]) * K[j, k] - K[i, k] * PHt[j, k]
            P[i, j] += change
            P[j, i] = P[i, j]


@compiled
def constrain(x: Array, P: Array, i: int, bounds: tuple[float, float], considered: Array) -> None:
    """Project a state back to its bounds.

    Correlated states that are not ``considered`` (n,) change as well.
    """
    off = kernels.clamp(x[i], bounds[0], bounds[1]) - x[i]
    if off == 0.0:
        return
    bound, variance = x[i] + off, P[i, i]
    if variance > 0.0:
        for j in range(len(x)):
            if considered[j] == 0.0:
                x[j] += P[j, i] / variance * off
    x[i] = bound


@compiled
def product(A: Array, B: Array) -> Array:
    """Return A B; A is sparse."""
    rows, columns = len(A), B.shape[1]
    result = np.zeros((rows, columns))
    for i in range(rows):
        for k in range(len(B)):
            a = A[i, k]
            if a != 0.0:
                for j in range(columns):
                    result[i, j] += a * B[k, j]
    return result


@compiled
def inverse(S: Array) -> Array:
    """Return the inverse of a symmetric matrix (3, 3)."""
    inverse = np.empty((3, 3))
    a, b, c = kernels.vector(S[0]), kernels.vector(S[1]), kernels.vector(S[2])
    rows = kernels.cross(b, c), kernels.cross(c, a), kernels.cross(a, b)
    determinant = kernels.dot(a, rows[0])
    for k in range(3):
        kernels.store_vector(kernels.scaled(1.0 / determinant, rows[k]), inverse[k])
    return inverse
