# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""SO(3) against its group laws, exact arithmetic and SciPy."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from quad_mpc_ros.control.lie import Array, kernels, so3

thorough = settings(deadline=None)

components = st.floats(-1.0, 1.0, allow_subnormal=False)
axes = (
    st.tuples(components, components, components)
    .map(np.array)
    .filter(lambda v: float(np.linalg.norm(v)) > 0.05)
    .map(lambda v: v / np.linalg.norm(v))
)


def turned_by(angles: st.SearchStrategy[float]) -> st.SearchStrategy[Array]:
    return st.tuples(axes, angles).map(lambda drawn: drawn[0] * drawn[1])


near_identity = turned_by(st.floats(0.0, 1e-7))
below_pi = turned_by(st.floats(0.0, math.pi - 1e-9))
near_pi = turned_by(st.floats(1e-9, 1e-6).map(lambda gap: math.pi - gap))
about_pi = turned_by(st.floats(-1e-9, 1e-9).map(lambda gap: math.pi + gap))
in_the_tangent = turned_by(st.floats(0.0, 30.0))
# Where one formula hands over to another.
at_a_seam = turned_by(
    st.sampled_from([1e-3, 2e-3, 0.05]).flatmap(lambda a: st.floats(0.99 * a, 1.01 * a))
)
uniform = (
    st.integers(0, 2**32 - 1)
    .map(lambda seed: np.random.default_rng(seed).normal(size=4))
    .map(lambda q: Rotation.from_quat(q).as_matrix())
)
rotations = st.one_of(
    uniform,
    *(
        drawn.map(lambda phi: Rotation.from_rotvec(phi).as_matrix())
        for drawn in (near_identity, near_pi, about_pi, in_the_tangent)
    ),
)
short_vectors = st.one_of(below_pi, near_identity, near_pi, at_a_seam)


def exact_exp(phi: Array) -> Array:
    """Return the power series of the matrix exponential in 200 bits, rounded once."""
    one = 1 << 200
    x, y, z = (int(Fraction(float(component)) * one) for component in phi)
    skew = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    term = [[one * (i == j) for j in range(3)] for i in range(3)]
    total = [row[:] for row in term]
    for n in range(1, 36):
        term = [
            [sum(term[i][k] * skew[k][j] for k in range(3)) // (n * one) for j in range(3)]
            for i in range(3)
        ]
        total = [[total[i][j] + term[i][j] for j in range(3)] for i in range(3)]
    return np.array([[entry / one for entry in row] for row in total])


@thorough
@given(components, components, components, axes)
def test_hat_is_the_cross_product(x: float, y: float, z: float, b: Array) -> None:
    a = np.array([x, y, z])
    assert_allclose(so3.hat(a) @ b, np.cross(a, b), rtol=0.0, atol=1e-15)
    assert_array_equal(so3.hat(a), -so3.hat(a).T)


@settings(deadline=None, max_examples=60)
@given(st.one_of(short_vectors, about_pi))
def test_exp_is_the_matrix_exponential(phi: Array) -> None:
    assert_allclose(so3.exp(phi), exact_exp(phi), rtol=0.0, atol=1e-15)


@thorough
@given(rotations)
def test_exp_undoes_log(R: Array) -> None:
    assert_allclose(so3.exp(so3.log(R)), R, rtol=0.0, atol=4e-15)


@thorough
@given(short_vectors)
def test_log_undoes_exp_below_pi(phi: Array) -> None:
    assert_allclose(so3.log(so3.exp(phi)), phi, rtol=0.0, atol=4e-15)


@thorough
@given(rotations)
def test_log_is_the_shortest_rotation(R: Array) -> None:
    phi = so3.log(R)
    assert np.linalg.norm(phi) <= math.pi + 9e-16  # two units in the last place
    expected = Rotation.from_matrix(R).as_rotvec()
    if np.linalg.norm(expected) < math.pi - 1e-8:
        assert_allclose(phi, expected, rtol=0.0, atol=1e-14)


@thorough
@given(axes)
def test_log_is_exact_at_pi(axis: Array) -> None:
    phi = so3.log(2.0 * np.outer(axis, axis) - np.eye(3))
    assert np.linalg.norm(phi) == pytest.approx(math.pi, abs=1e-12)
    assert_allclose(abs(phi @ axis), math.pi, atol=1e-12)


@pytest.mark.parametrize("gap", [1e-3, 1e-6, 1e-9, 1e-12])
@settings(deadline=None, max_examples=30)
@given(axis=axes)
def test_log_keeps_the_distance_from_pi(gap: float, axis: Array) -> None:
    phi = so3.log(exact_exp((math.pi - gap) * axis))
    assert_allclose(phi, (math.pi - gap) * axis, rtol=0.0, atol=4e-15)


@pytest.mark.parametrize("angle", [1e-9, 1e-7, 1e-5, 9.99e-4, 1.99e-3, 2.01e-3, 0.01, 0.1])
@settings(deadline=None, max_examples=20)
@given(axis=axes)
def test_log_keeps_its_relative_accuracy_near_identity(angle: float, axis: Array) -> None:
    phi = so3.log(exact_exp(angle * axis))
    assert np.linalg.norm(phi - angle * axis) < 3e-15 * angle


def matrix_of(kernel: Callable[[Any], Any], phi: Array) -> Array:
    """Return the matrix (3, 3) that a compiled function gives for a rotation vector."""
    return np.array(kernel(tuple(phi.tolist()))).reshape(3, 3)


@settings(deadline=None, max_examples=50)
@given(st.one_of(short_vectors, about_pi))
def test_right_jacobian_is_the_mean_of_inverse_rotations(phi: Array) -> None:
    """J_r = integral of exp(-s phi) over s from 0 to 1, by a quadrature that is exact here."""
    nodes, weights = np.polynomial.legendre.leggauss(20)
    turns = np.stack([Rotation.from_rotvec(-s * phi).as_matrix() for s in 0.5 * (nodes + 1.0)])
    mean = np.einsum("s,sij->ij", 0.5 * weights, turns)
    assert_allclose(matrix_of(kernels.right_jacobian, phi), mean, rtol=0.0, atol=5e-15)


@thorough
@given(st.one_of(short_vectors, about_pi, turned_by(st.floats(3.0, 5.0))))
def test_inverse_of_the_right_jacobian(phi: Array) -> None:
    inverse = matrix_of(kernels.right_jacobian_inverse, phi)
    assert_allclose(inverse @ matrix_of(kernels.right_jacobian, phi), np.eye(3), atol=1e-13)


# Identity, tiny, small, ordinary and half turns, and both sides of the seams between formulas.
ANGLES = [
    0.0,
    1e-9,
    0.99e-3,
    1.01e-3,
    1.99e-3,
    2.01e-3,
    0.049,
    0.051,
    1.0,
    3.0,
    3.1415926,
    math.pi,
]


def at_every_angle(axes_each: int) -> Array:
    """Return rotation vectors (axes_each, 12, 3)."""
    directions = np.random.default_rng(1).normal(size=(axes_each, len(ANGLES), 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return np.asarray(directions * np.array(ANGLES)[:, None])


def test_branches_agree_at_their_boundaries() -> None:
    """As a batch, where single vectors may go another way."""
    phi = at_every_angle(20)
    exact = np.array([exact_exp(each) for each in phi.reshape(-1, 3)]).reshape(*phi.shape, 3)
    assert_allclose(so3.exp(phi), exact, rtol=0.0, atol=1e-15)
    below = phi[:, :-1]
    assert_allclose(so3.log(exact[:, :-1]), below, rtol=0.0, atol=4e-15)
    small = phi[:, 1:8]
    error = np.linalg.norm(so3.log(exact[:, 1:8]) - small, axis=-1)
    assert (error < 3e-15 * np.linalg.norm(small, axis=-1)).all()


BATCHED: dict[str, tuple[Callable[[Array], Array], int]] = {
    "hat": (so3.hat, 1),
    "exp": (so3.exp, 1),
    "log": (so3.log, 2),
    "rotation_from_quaternion_xyzw": (so3.rotation_from_quaternion_xyzw, 1),
    "quaternion_xyzw_from_rotation": (so3.quaternion_xyzw_from_rotation, 2),
}


@pytest.mark.parametrize("name", BATCHED)
@pytest.mark.parametrize("shape", [(), (1,), (12,), (5, 12), (0,)])
def test_a_batch_equals_its_elements(name: str, shape: tuple[int, ...]) -> None:
    function, dimensions = BATCHED[name]
    rng = np.random.default_rng(1)
    count = math.prod(shape)
    phi = rng.normal(size=(count, 3))
    phi /= np.linalg.norm(phi, axis=-1, keepdims=True)
    phi *= np.resize(ANGLES, count)[:, None]
    if dimensions == 2:
        single = Rotation.from_rotvec(phi).as_matrix() if count else np.zeros((0, 3, 3))
    elif "quaternion" in name:
        single = rng.normal(size=(count, 4))
    else:
        single = phi
    batch = function(single.reshape(shape + single.shape[1:]))
    assert batch.shape[: len(shape)] == shape
    for found, each in zip(
        batch.reshape((count, *batch.shape[len(shape) :])), single, strict=True
    ):
        expected = function(each)
        assert found.shape == expected.shape
        assert_allclose(found, expected, rtol=4e-16, atol=1e-15)


@thorough
@given(st.integers(0, 2**32 - 1), st.floats(1e-3, 1e3))
def test_rotation_of_a_quaternion_agrees_with_scipy(seed: int, length: float) -> None:
    q = length * np.random.default_rng(seed).normal(size=4)
    assert_allclose(
        so3.rotation_from_quaternion_xyzw(q), Rotation.from_quat(q).as_matrix(), atol=1e-14
    )


@thorough
@given(rotations)
def test_quaternion_of_a_rotation_agrees_with_scipy(R: Array) -> None:
    q = so3.quaternion_xyzw_from_rotation(R)
    expected = Rotation.from_matrix(R).as_quat()
    assert q[3] >= 0.0
    assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-15)
    assert min(np.abs(q - expected).max(), np.abs(q + expected).max()) < 1e-14


@pytest.mark.parametrize(
    "q", [[0.0, 0.0, 0.0, 0.0], [math.nan, 0.0, 0.0, 1.0], [0.0, math.inf, 0.0, 1.0]]
)
def test_rejects_zero_and_nonfinite_quaternions(q: list[float]) -> None:
    with pytest.raises(ValueError, match="expected a quaternion that is finite and not zero"):
        so3.rotation_from_quaternion_xyzw(q)
    with pytest.raises(ValueError, match="expected a quaternion that is finite and not zero"):
        so3.rotation_from_quaternion_xyzw([[0.0, 0.0, 0.0, 1.0], q])
