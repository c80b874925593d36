# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A horizon as a sparse quadratic program: its numbers, and OSQP's matrices of a fixed pattern::

    minimise    sum_{i=1..N}   1/2 x_i' H_i x_i + g_i' x_i
              + sum_{i=0..N-1} 1/2 u_i' R_i u_i + r_i' u_i
              + sum_{i=0..N-1} c_i' s_i + 1/2 s_i' D_i s_i
    subject to  x_{i+1} = A_i x_i + B_i u_i,   lower_i <= u_i <= upper_i,   x_0 given
                n_ij' x_{i+1} - s_i,k(j) <= b_ij,   s_i >= 0

x_0 is a constant and is not a variable. The variables are interleaved, (u_0, x_1, s_0, u_1, x_2,
s_1, ...), so that the problem is banded. Variables are divided by their natural size and each
dynamics row by the size of its state: without this scaling OSQP needs up to ten times the
iterations and returns inputs wrong by a third of their range. Without soft rows the matrices
contain no slacks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels

FREE = 1e9
"""An inactive bound, below the value that OSQP treats as infinity."""

# Found on jumps of the reference, with soft rows: bounds on inputs as loose as this take a third
# of the iterations.
_INPUT_ROW = 0.3

Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class LimitPattern:
    """Soft inequalities of a stage: nr rows, each relaxed by one of ns slacks.

    ``mask`` (nr, nx) marks the entries of x_{i+1} in each row. ``slack_of`` (nr,), ascending, is
    the slack of each row. ``slack_size`` (ns,) > 0 is the natural size of a slack, in the unit of
    its rows. Rows that share a slack share its cost: the most violated row determines the slack.
    """

    mask: Mask
    slack_of: NDArray[np.intp]
    slack_size: Array


NO_LIMITS = LimitPattern(
    mask=np.zeros((0, 0), dtype=bool), slack_of=np.zeros(0, dtype=np.intp), slack_size=np.zeros(0)
)


@dataclass(frozen=True, kw_only=True, eq=False)
class HorizonPattern:
    """The possibly non-zero entries of a stage, and the natural size of each variable.

    ``A`` (nx, nx), ``B`` (nx, nu) and ``H`` (nx, nx, symmetric) are masks; ``state_size`` (nx,)
    and ``input_size`` (nu,) are positive. Without ``limits`` a stage has no soft rows.
    """

    steps: int
    A: Mask
    B: Mask
    H: Mask
    state_size: Array
    input_size: Array
    limits: LimitPattern = NO_LIMITS

    @property
    def sizes(self) -> tuple[int, int, int, int, int]:
        """Number of stages, and of states, inputs, soft rows and slacks per stage."""
        nx, nu, nr = len(self.state_size), len(self.input_size), len(self.limits.mask)
        return self.steps, nx, nu, nr, len(self.limits.slack_size)


class HorizonStages(NamedTuple):
    """The numbers of one horizon in physical units, to be written in place.

    ``x0`` (nx,) is the state at its start. Stages 0 to N - 1 have the dynamics ``A`` (N, nx, nx),
    ``B`` (N, nx, nu); states 1 to N the cost ``H`` (N, nx, nx, symmetric) and ``g`` (N, nx);
    inputs the diagonal of ``R``, ``r`` and the bounds ``lower``, ``upper`` (N, nu); and soft rows,
    normal · x_{i+1} - slack <= offset, the ``normals`` (N, nr, nx), ``offsets`` (N, nr) and the
    cost of each slack s >= 0, ``linear`` s + 1/2 ``quadratic`` s^2 (N, ns).
    """

    x0: Array
    A: Array
    B: Array
    H: Array
    g: Array
    R: Array
    r: Array
    lower: Array
    upper: Array
    normals: Array
    offsets: Array
    linear: Array
    quadratic: Array

    @staticmethod
    def zeros(steps: int, nx: int, nu: int, nr: int = 0, ns: int = 0) -> HorizonStages:
        """Return zeros for N stages of nx states and nu inputs, nr soft rows and ns slacks."""
        return HorizonStages(
            x0=np.zeros(nx),
            A=np.zeros((steps, nx, nx)),
            B=np.zeros((steps, nx, nu)),
            H=np.zeros((steps, nx, nx)),
            g=np.zeros((steps, nx)),
            R=np.zeros((steps, nu)),
            r=np.zeros((steps, nu)),
            lower=np.zeros((steps, nu)),
            upper=np.zeros((steps, nu)),
            normals=np.zeros((steps, nr, nx)),
            offsets=np.zeros((steps, nr)),
            linear=np.zeros((steps, ns)),
            quadratic=np.zeros((steps, ns)),
        )


class HorizonQP:
    """OSQP's form ``min 1/2 z'Pz + q'z, l <= Az <= u`` of a horizon, updated in place.

    ``P`` (upper triangle) and ``A`` keep their pattern; :meth:`update` writes into their data and
    into ``q``, ``lower``, ``upper`` without allocating matrices. The rows of ``A`` are the
    dynamics, the bounds of inputs, the soft rows and the bounds of slacks.
    """

    def __init__(self, pattern: HorizonPattern) -> None:
        self.pattern = pattern
        n, nx, nu, nr, _ = pattern.sizes
        self.scales = scales = _scales_of(pattern)
        self.A, self.P = _constraint_matrix(pattern, scales), _cost_matrix(pattern, scales)
        rows, columns = self.A.shape
        self.q, self.lower, self.upper = np.zeros(columns), np.zeros(rows), np.zeros(rows)
        self.numbers = Numbers(self.P.data, self.q, self.A.data, self.lower, self.upper)
        self.is_soft = nr > 0
        self.first_soft_row = n * (nx + nu)
        """The first soft row; further soft rows and the bounds of slacks follow."""
        self.lower[self.first_soft_row : self.first_soft_row + n * nr] = -FREE
        self.upper[self.first_soft_row :] = FREE
        self.cost_scale = 1.0
        """Factor on the cost, and so on the multipliers; 1 without soft rows."""
        self.magnitude = 0.0
        """Upper bound on the magnitude of all numbers of the problem; NaN if any is NaN."""

    def update(self, stages: HorizonStages) -> None:
        """Write the numbers of a horizon with the sizes of the pattern."""
        self.cost_scale, self.magnitude = _write(stages, self.scales, self.numbers)


class Scales(NamedTuple):
    """Factor of each entry of a stage's blocks, 0 outside of the pattern, and sizes.

    ``A`` (nx, nx), ``B`` (nx, nu), ``H`` (nx, nx, upper triangle) and ``normals`` (nr, nx)
    multiply the numbers of the stages. ``sizes`` (nu + nx + ns,) are the natural sizes of a
    stage's variables, ``slack_of`` (nr,) is the slack of each soft row, ``input_row`` the entry
    of a bounded input.
    """

    A: Array
    B: Array
    H: Array
    normals: Array
    sizes: Array
    slack_of: NDArray[np.intp]
    input_row: float


def _scales_of(pattern: HorizonPattern) -> Scales:
    state, size, soft = pattern.state_size, pattern.input_size, pattern.limits
    row_size = soft.slack_size[soft.slack_of]
    return Scales(
        A=np.where(pattern.A, -state / state[:, None], 0.0),
        B=np.where(pattern.B, -size / state[:, None], 0.0),
        H=np.triu(np.where(pattern.H, state * state[:, None], 0.0)),
        normals=np.where(soft.mask.reshape(-1, len(state)), state / row_size[:, None], 0.0),
        sizes=np.concatenate((size, state, soft.slack_size)),
        slack_of=soft.slack_of,
        input_row=_INPUT_ROW if len(soft.mask) > 0 else 1.0,
    )


def _constraint_matrix(pattern: HorizonPattern, scales: Scales) -> sparse.csc_matrix:
    """Return ``A``, with arbitrary numbers in its pattern."""
    n, nx, nu, nr, ns = pattern.sizes
    none = np.zeros
    before = np.hstack((none((nx, nu)), scales.A, none((nx, ns))))
    dynamics = np.hstack((scales.B, np.eye(nx), none((nx, ns))))
    others = (
        np.hstack((scales.input_row * np.eye(nu), none((nu, nx + ns)))),
        np.hstack((none((nr, nu)), scales.normals, -np.eye(ns)[scales.slack_of])),
        np.hstack((none((ns, nu + nx)), np.eye(ns))),
    )
    first, *rest = (sparse.kron(sparse.eye(n), each, format="csc") for each in (dynamics, *others))
    earlier = sparse.kron(sparse.eye(n, k=-1), before, format="csc")
    matrix = sparse.csc_matrix(sparse.vstack([first + earlier, *rest]))
    matrix.sort_indices()
    return matrix


def _cost_matrix(pattern: HorizonPattern, scales: Scales) -> sparse.csc_matrix:
    """Return the upper triangle of ``P``, with arbitrary numbers in its pattern."""
    n, _, nu, _, ns = pattern.sizes
    blocks = [sparse.csc_matrix(block) for block in (np.eye(nu), scales.H, np.eye(ns))]
    return sparse.csc_matrix(sparse.block_diag(blocks * n))


class Numbers(NamedTuple):
    """The numbers of OSQP's form: entries of ``P`` and ``A``, and its vectors."""

    P: Array
    q: Array
    A: Array
    lower: Array
    upper: Array


@compiled
def _write(stages: HorizonStages, scales: Scales, numbers: Numbers) -> tuple[float, float]:
    """Write the numbers of the QP; return the factor on its cost, and their magnitude."""
    _write_matrix(stages, scales, numbers.A)
    _write_cost(stages, scales, numbers)
    _write_bounds(stages, scales, numbers)
    if len(scales.slack_of) == 0:
        return 1.0, _magnitude(numbers)
    factor = 1.0 / max(1.0, kernels.infinity_norm(numbers.q))
    for k in range(len(numbers.q)):
        numbers.q[k] *= factor
    for k in range(len(numbers.P)):
        numbers.P[k] *= factor
    return factor, _magnitude(numbers)


@compiled
def _write_matrix(stages: HorizonStages, scales: Scales, data: Array) -> None:
    """Write ``A``, column by column, without calls or branches per entry.

    An entry outside of the pattern is overwritten by the next entry.
    """
    A, B, normals, slack_of, k = stages.A, stages.B, stages.normals, scales.slack_of, 0
    of_A, of_B, of_normals = scales.A, scales.B, scales.normals
    n, nx, nu = B.shape
    for i in range(n):
        for j in range(nu):  # of u_i: B_i, its bound
            for row in range(nx):
                data[k] = of_B[row, j] * B[i, row, j]
                k += of_B[row, j] != 0.0
            data[k] = scales.input_row
            k += 1
        for j in range(nx):  # of x_{i+1}: one, A_{i+1}, normals
            data[k] = 1.0
            k += 1
            for row in range(nx if i + 1 < n else 0):
                data[k] = of_A[row, j] * A[i + 1, row, j]
                k += of_A[row, j] != 0.0
            for row in range(len(slack_of)):
                data[k] = of_normals[row, j] * normals[i, row, j]
                k += of_normals[row, j] != 0.0
        for j in range(len(slack_of)):  # of the slacks: their rows, then their bound
            data[k] = -1.0
            k += 1
            if j + 1 == len(slack_of) or slack_of[j + 1] != slack_of[j]:
                data[k] = 1.0
                k += 1


@compiled
def _write_cost(stages: HorizonStages, scales: Scales, numbers: Numbers) -> None:
    """Write ``P``, column by column, and ``q``."""
    n, nx, nu = stages.B.shape
    ns, sizes, k, z = stages.linear.shape[1], scales.sizes, 0, 0
    for i in range(n):
        for j in range(nu):
            numbers.P[k] = stages.R[i, j] * sizes[j] * sizes[j]
            numbers.q[z] = stages.r[i, j] * sizes[j]
            k, z = k + 1, z + 1
        for j in range(nx):
            for row in range(j + 1):
                if scales.H[row, j] != 0.0:
                    numbers.P[k] = scales.H[row, j] * stages.H[i, row, j]
                    k += 1
            numbers.q[z] = stages.g[i, j] * sizes[nu + j]
            z += 1
        for j in range(ns):
            size = sizes[nu + nx + j]
            numbers.P[k] = stages.quadratic[i, j] * size * size
            numbers.q[z] = stages.linear[i, j] * size
            k, z = k + 1, z + 1


@compiled
def _write_bounds(stages: HorizonStages, scales: Scales, numbers: Numbers) -> None:
    """Write the right-hand sides of the dynamics, and the bounds of inputs and soft rows."""
    n, nx, nu = stages.B.shape
    nr, sizes = len(scales.slack_of), scales.sizes
    for k in range(nx):  # columns of later stages are zero
        A_x0 = 0.0
        for j in range(nx):
            A_x0 += stages.A[0, k, j] * stages.x0[j]
        numbers.lower[k] = numbers.upper[k] = A_x0 / sizes[nu + k]
    for i in range(n):
        for k in range(nu):
            row = n * nx + i * nu + k
            numbers.lower[row] = stages.lower[i, k] / sizes[k] * scales.input_row
            numbers.upper[row] = stages.upper[i, k] / sizes[k] * scales.input_row
        for j in range(nr):
            row, size = n * (nx + nu) + i * nr + j, sizes[nu + nx + scales.slack_of[j]]
            numbers.upper[row] = min(stages.offsets[i, j] / size, FREE)


@compiled
def _magnitude(numbers: Numbers) -> float:
    """Return the largest magnitude of all numbers; NaN if any is NaN."""
    cost = kernels.infinity_norm(numbers.P), kernels.infinity_norm(numbers.q)
    rows = kernels.infinity_norm(numbers.lower), kernels.infinity_norm(numbers.upper)
    A = kernels.infinity_norm(numbers.A)
    total = cost[0] + cost[1] + rows[0] + rows[1] + A
    return total if math.isnan(total) else max(cost[0], cost[1], rows[0], rows[1], A)


@compiled
def warm_start(
    z: Array, kept: Array, y: Array, cost_scale: float, scales: Scales, numbers: Numbers
) -> None:
    """Write a start for a problem with soft rows, from variables ``z`` and ``kept`` multipliers.

    ``kept`` are multipliers of the cost without its scale. The slacks, written into ``z``, are the
    row violations with all other variables zero. The multipliers ``y`` of the slack bounds are the
    slack costs minus the row multipliers.
    """
    for k in range(len(y)):
        y[k] = cost_scale * kept[k]
    slack_of, width = scales.slack_of, len(scales.sizes)
    nr, ns, steps = len(slack_of), slack_of[-1] + 1, len(z) // width
    soft_rows = steps * (width - ns)
    slack_rows = soft_rows + steps * nr
    for i in range(steps):
        for k in range(ns):
            slack, bound = i * width + width - ns + k, slack_rows + i * ns + k
            z[slack], y[bound] = 0.0, -numbers.q[slack]
            for j in range(nr):
                if slack_of[j] == k:
                    row = soft_rows + i * nr + j
                    z[slack] = max(z[slack], -numbers.upper[row])
                    y[bound] += y[row]
            y[bound] = min(y[bound], 0.0)


@compiled
def read(
    z: Array, y: Array, cost_scale: float, scales: Scales, inputs: Array, states: Array
) -> bool:
    """Write inputs (N, nu) and states 1 to N (N, nx) of a solution in physical units.

    The multipliers ``y`` become multipliers of the cost without its scale. Returns whether all
    numbers are finite.
    """
    nx, nu = scales.B.shape
    sizes = scales.sizes
    for i in range(len(inputs)):
        first = i * len(sizes)
        for k in range(nu):
            inputs[i, k] = z[first + k] * sizes[k]
        for k in range(nx):
            states[i, k] = z[first + nu + k] * sizes[nu + k]
    for k in range(len(y)):
        y[k] /= cost_scale
    return math.isfinite(kernels.infinity_norm(z)) and math.isfinite(kernels.infinity_norm(y))
