# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Pairs of vectors that must be equal: their low-pass, their sums of products, and the test.

With y = M x, every M is the identity. Flipped or swapped axes, a wrong heading, wrong units, a
conjugated attitude, reversed rates or missing thrust each change M. Both sides are low-passed
equally, which keeps M. M is estimated by least squares with the identity as prior: with S the
weighted sums of the last ``_MEMORY`` seconds,

    M = (S_yx + r I) (S_xx + r I)^-1,    r = floor^2 _MEMORY + share^2 tr(S_xx + S_ee).

The prior r outweighs motion below the floor, and motion in a direction with a small share of the
total motion or of the difference e = y - x, which a wrong mass or drag causes along the main
direction. A relation is contradicted if the smallest eigenvalue of the symmetric part of M is too
small, or if one side is rotated against the other: in the plane of axes i and j by the sine
(S_yx,ji - S_yx,ij) / (S_xx,ii + S_xx,jj + 2 r).

The difference of x and y within a sample is bounded, so that one jump counts little. Noise of a
differentiated position or attitude passes two stages of low-pass; where the bound clips such
noise, the noise does not average out, and its clipped mean square is added to the floor's.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Matrix3, Record, Vector3
from quad_mpc_ros.control.estimation.kalman import inverse
from quad_mpc_ros.control.lie import Array, kernels

_MEMORY = 0.6  # s
_NOISE_FORGETTING = 0.15  # over the forgetting of a stage of the low-pass


class RelationLimits(NamedTuple):
    """Limits beyond which a relation is contradicted.

    Attributes:
        floor: Magnitude of x that counts as motion.
        share: Share of both sides and their difference that counts as motion in a direction.
        least: Smallest eigenvalue of the symmetric part of M.
        twist: Largest magnitude of the skew part of M.
    """

    floor: float
    share: float
    least: float
    twist: float


class Sides(Record):
    """Both low-passed sides of a relation."""

    x: Vector3
    y: Vector3


class Pair(Record):
    """Both low-passed sides of a relation, their means, and weighted sums of products."""

    mean_x: Vector3  # 0 if the sides are compared as they are
    mean_y: Vector3
    x: Vector3
    y: Vector3
    xx: Matrix3
    yx: Matrix3
    yy: Matrix3


class KinematicPair(Pair):
    """The pair of a kinematic relation, low-passed by two stages."""

    first: Sides  # after the first stage
    difference: Vector3  # y - x of the last sample
    noise: float  # mean square of the noise in x or y because of the bound on a sample


@compiled
def lowpass(
    sides: Sides | Pair, x: kernels.Vector, y: kernels.Vector, farthest: float, times: float
) -> None:
    """Low-pass both sides over ``times`` time constants, with less weight beyond ``farthest``."""
    distance = kernels.norm(kernels.minus(y, x))
    weight = farthest / distance if distance > farthest else 1.0
    share = -math.expm1(-times)
    for k in range(3):
        sides.x[k] += share * (weight * x[k] - sides.x[k])
        sides.y[k] += share * (weight * y[k] - sides.y[k])


@compiled
def lowpass_twice(
    pair: KinematicPair, x: kernels.Vector, y: kernels.Vector, farthest: float, times: float
) -> None:
    """Low-pass both sides with two stages of ``times`` time constants each."""
    difference = kernels.minus(y, x)
    distance = kernels.norm(difference)
    turns_back = kernels.dot(difference, kernels.vector(pair.difference)) < 0.0
    cut = kernels.clamp(distance - farthest, 0.0, farthest) if turns_back else 0.0
    kernels.store_vector(difference, pair.difference)
    share = -math.expm1(-times)
    # Two stages reduce the variance of white noise to a quarter of the share of one sample.
    pair.noise += _NOISE_FORGETTING * share * (0.25 * share * cut * cut - pair.noise)
    lowpass(pair.first, x, y, farthest, times)
    first = kernels.vector(pair.first.x), kernels.vector(pair.first.y)
    lowpass(pair, first[0], first[1], math.inf, times)


@compiled
def follow_means(pair: Pair, duration: float) -> None:
    """Low-pass the means of both sides, to which their changes are relative."""
    share = -math.expm1(-duration / _MEMORY)
    for k in range(3):
        pair.mean_x[k] += share * (pair.x[k] - pair.mean_x[k])
        pair.mean_y[k] += share * (pair.y[k] - pair.mean_y[k])


@compiled
def add_products(pair: Pair, duration: float) -> None:
    """Add the products of both sides, relative to their means, to the decaying sums."""
    x = kernels.minus(kernels.vector(pair.x), kernels.vector(pair.mean_x))
    y = kernels.minus(kernels.vector(pair.y), kernels.vector(pair.mean_y))
    kept = math.exp(-duration / _MEMORY)
    for i in range(3):
        for j in range(3):
            pair.xx[i, j] = kept * pair.xx[i, j] + duration * x[i] * x[j]
            pair.yx[i, j] = kept * pair.yx[i, j] + duration * y[i] * x[j]
            pair.yy[i, j] = kept * pair.yy[i, j] + duration * y[i] * y[j]


@compiled
def forget(pair: Pair) -> None:
    """Reset a relation."""
    pair.x[:], pair.y[:], pair.mean_x[:], pair.mean_y[:] = 0.0, 0.0, 0.0, 0.0
    pair.xx[:], pair.yx[:], pair.yy[:] = 0.0, 0.0, 0.0


@compiled
def trace(sums: Array) -> float:
    """Return the trace (sum of squares) of sums of products (3, 3)."""
    return float(sums[0, 0] + sums[1, 1] + sums[2, 2])


@compiled
def is_contradicted(
    yx: Array, xx: Array, y_squares: float, limits: RelationLimits, noise: float = 0.0
) -> bool:
    """Whether no M near the identity satisfies y = M x.

    Args:
        yx: Weighted sums of products y x' (3, 3).
        xx: Weighted sums of products x x' (3, 3).
        y_squares: Weighted sum of the squares of y.
        limits: Limits of the relation.
        noise: Mean square of the noise in x or y.
    """
    difference = y_squares - 2.0 * trace(yx) + trace(xx)
    prior = (limits.floor**2 + noise) * _MEMORY + limits.share**2 * (trace(xx) + difference)
    A, M = xx.copy(), np.zeros((3, 3))
    for k in range(3):
        A[k, k] += prior
    inverted = inverse(A)
    for i in range(3):
        for j in range(3):
            for k in range(3):
                M[i, j] += (yx[i, k] + (prior if i == k else 0.0)) * inverted[k, j]
    a, b, c = M[0, 0] - limits.least, M[1, 1] - limits.least, M[2, 2] - limits.least
    d, e, f = (
        0.5 * (M[0, 1] + M[1, 0]),
        0.5 * (M[0, 2] + M[2, 0]),
        0.5 * (M[1, 2] + M[2, 1]),
    )
    # Positive definite: all leading minors of the symmetric part less the limit are positive.
    determinant = a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)
    above = a > 0.0 and a * b - d * d > 0.0 and determinant > 0.0
    # From the sums instead of M, whose entries across the main direction are uncertain.
    twist = 0.0
    for i, j in ((0, 1), (0, 2), (1, 2)):
        turn = (yx[j, i] - yx[i, j]) / (xx[i, i] + xx[j, j] + 2.0 * prior)
        twist += turn * turn
    return not above or math.sqrt(twist) > limits.twist
