"""The horizon as a sparse quadratic program with a fixed pattern.

    minimise    sum_{i=1..N}   1/2 x_i' H_i x_i + g_i' x_i
              + sum_{i=0..N-1} 1/2 u_i' R_i u_i + r_i' u_i
    subject to  x_{i+1} = A_i x_i + B_i u_i + c_i,   lower_i <= u_i <= upper_i,   x_0 given

x_0 is a constant and is not a variable. The variables are interleaved, (u_0, x_1, u_1, x_2, ...),
so that the problem is banded. They are divided by their natural size and each dynamics row by
the size of its state: without that OSQP needs up to ten times the iterations and returns inputs
wrong by a third of their range.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from quad_mpc_ros.compilation import compiled
from quad_mpc_ros.lie import Array
from quad_mpc_ros.lie.kernels import infinity_norm

Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class HorizonPattern:
    """Which entries of a stage can ever be non-zero, and the natural size of each variable.

    ``A`` (nx, nx), ``B`` (nx, nu) and ``H`` (nx, nx, symmetric) are masks; ``state_size`` (nx,)
    and ``input_size`` (nu,) are positive.
    """

    steps: int
    A: Mask
    B: Mask
    H: Mask
    state_size: Array
    input_size: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class HorizonStages:
    """The numbers of one horizon in physical units, to be written in place.

    Shapes: ``x0`` (nx,), ``A`` (N, nx, nx), ``B`` (N, nx, nu), ``c`` (N, nx), ``H`` (N, nx, nx)
    and ``g`` (N, nx) for the states 1 to N, ``R`` (N, nu) diagonal, ``r``, ``lower``, ``upper``
    (N, nu).
    """

    x0: Array
    A: Array
    B: Array
    c: Array
    H: Array
    g: Array
    R: Array
    r: Array
    lower: Array
    upper: Array

    @staticmethod
    def zeros(steps: int, nx: int, nu: int) -> HorizonStages:
        """Return room for a horizon."""
        return HorizonStages(
            x0=np.zeros(nx),
            A=np.zeros((steps, nx, nx)),
            B=np.zeros((steps, nx, nu)),
            c=np.zeros((steps, nx)),
            H=np.zeros((steps, nx, nx)),
            g=np.zeros((steps, nx)),
            R=np.zeros((steps, nu)),
            r=np.zeros((steps, nu)),
            lower=np.zeros((steps, nu)),
            upper=np.zeros((steps, nu)),
        )


class HorizonQP:
    """OSQP's form ``min 1/2 z'Pz + q'z, l <= Az <= u`` of a horizon, updated in place.

    ``P`` (upper triangle) and ``A`` keep their pattern for life; :meth:`update` writes into their
    data and into ``q``, ``l``, ``u`` without allocating matrices.
    """

    def __init__(self, pattern: HorizonPattern) -> None:
        self.pattern = pattern
        state, size = pattern.state_size, pattern.input_size
        n, nx, nu = pattern.steps, len(state), len(size)
        self._n, self._nx, self._nu = n, nx, nu
        self._shape = n, nx, nu
        self._sizes = state, size
        count = n * (nx + nu)
        self.A, A_places = _assemble(self._constraint_blocks(), shape=(count, count))
        self.P, P_places = _assemble(self._cost_blocks(), shape=(count, count))
        self.q, self.lower, self.upper = np.zeros(count), np.zeros(count), np.zeros(count)

        count_A, count_B = (n - 1) * int(pattern.A.sum()), n * int(pattern.B.sum())
        self.A.data[A_places[count_A + count_B :]] = 1.0  # next states and bounded inputs
        count_H = n * int(np.triu(pattern.H).sum())
        self._fixed: _Fixed = (
            state,
            size,
            *_part(n, pattern.A, -state / state[:, None], A_places[:count_A], skipped=1),
            *_part(n, pattern.B, -size / state[:, None], A_places[count_A : count_A + count_B]),
            *_part(n, np.triu(pattern.H), state * state[:, None], P_places[:count_H]),
            P_places[count_H:],
            self.A.data,
            self.P.data,
            self.q,
            self.lower,
            self.upper,
        )
        self._size = 1.0

    def update(self, stages: HorizonStages) -> None:
        """Write the numbers of a horizon; shapes as in :class:`HorizonStages`."""
        if stages.B.shape != self._shape:
            # Compiled code does not look where it writes.
            raise ValueError(f"stages of shape {stages.B.shape}, expected {self._shape}")
        self._size = _write(
            stages.x0,
            stages.A,
            stages.B,
            stages.c,
            stages.H,
            stages.g,
            stages.R,
            stages.r,
            stages.lower,
            stages.upper,
            *self._fixed,
        )

    def size(self) -> float:
        """Return a number at least as large as each of the problem's; NaN when one is NaN."""
        return self._size

    def split(self, z: Array) -> tuple[Array, Array]:
        """Return inputs (N, nu) and states 1 to N (N, nx) of a solution, in physical units."""
        n, nx, nu = self._shape
        inputs, states = np.empty((n, nu)), np.empty((n, nx))
        _split(z, *self._sizes, inputs, states)
        return inputs, states

    def _input_at(self, stage: int) -> int:
        return stage * (self._nu + self._nx)

    def _state_at(self, stage: int) -> int:
        """First variable of state ``stage``, 1 to N."""
        return self._input_at(stage - 1) + self._nu

    def _constraint_blocks(self) -> list[tuple[Mask, int, int]]:
        """Return (mask, first row, first column) of every block, in the order of the entries."""
        n, nx, nu = self._n, self._nx, self._nu
        A, B, eye_x, eye_u = self.pattern.A, self.pattern.B, np.eye(nx) > 0, np.eye(nu) > 0
        return (
            [(A, i * nx, self._state_at(i)) for i in range(1, n)]
            + [(B, i * nx, self._input_at(i)) for i in range(n)]
            + [(eye_x, i * nx, self._state_at(i + 1)) for i in range(n)]
            + [(eye_u, n * nx + i * nu, self._input_at(i)) for i in range(n)]
        )

    def _cost_blocks(self) -> list[tuple[Mask, int, int]]:
        n, eye_u = self._n, np.eye(self._nu) > 0
        states = [self._state_at(i) for i in range(1, n + 1)]
        inputs = [self._input_at(i) for i in range(n)]
        H_upper = np.triu(self.pattern.H)
        return [(H_upper, k, k) for k in states] + [(eye_u, k, k) for k in inputs]


_Places = NDArray[np.intp]
_Part = tuple[_Places, Array, _Places]
_Fixed = tuple[
    Array, Array,  # sizes of states and inputs
    _Places, Array, _Places,  # part of A
    _Places, Array, _Places,  # part of B
    _Places, Array, _Places,  # part of H
    _Places,  # where R goes
    Array, Array, Array, Array, Array,  # A, P, q, lower, upper
]  # fmt: skip


def _part(steps: int, mask: Mask, scale: Array, places: _Places, *, skipped: int = 0) -> _Part:
    """Return where in all stages' matrices the masked entries are, their factors, and places.

    ``skipped`` stages have none.
    """
    entries = np.flatnonzero(mask)
    sources = np.arange(skipped, steps)[:, None] * mask.size + entries
    return sources.ravel(), np.tile(scale.ravel()[entries], steps - skipped), places


@compiled
def _split(z: Array, state_size: Array, input_size: Array, inputs: Array, states: Array) -> None:
    nu, nx = len(input_size), len(state_size)
    for i in range(len(inputs)):
        first = i * (nu + nx)
        for k in range(nu):
            inputs[i, k] = z[first + k] * input_size[k]
        for k in range(nx):
            states[i, k] = z[first + nu + k] * state_size[k]


@compiled
def _write(
    x0: Array,
    A: Array,
    B: Array,
    c: Array,
    H: Array,
    g: Array,
    R: Array,
    r: Array,
    least: Array,
    most: Array,
    state_size: Array,
    input_size: Array,
    # entries of A, B and H, what to multiply them with, where to write them
    sources_A: _Places,
    factors_A: Array,
    places_A: _Places,
    sources_B: _Places,
    factors_B: Array,
    places_B: _Places,
    sources_H: _Places,
    factors_H: Array,
    places_H: _Places,
    places_R: _Places,
    A_data: Array,
    P_data: Array,
    q: Array,
    lower: Array,
    upper: Array,
) -> float:
    """Write matrices, linear cost, right sides of the dynamics and bounds, all scaled.

    Return a number at least as large as each of them; NaN when one is NaN.
    """
    _scatter(A.reshape(-1), sources_A, factors_A, places_A, A_data)
    _scatter(B.reshape(-1), sources_B, factors_B, places_B, A_data)
    _scatter(H.reshape(-1), sources_H, factors_H, places_H, P_data)
    n, nx, nu = B.shape
    for i in range(n):
        for k in range(nu):
            size, bound = input_size[k], n * nx + i * nu + k
            P_data[places_R[i * nu + k]] = R[i, k] * size * size
            q[i * (nu + nx) + k] = r[i, k] * size
            lower[bound], upper[bound] = least[i, k] / size, most[i, k] / size
        for k in range(nx):
            q[i * (nu + nx) + nu + k] = g[i, k] * state_size[k]
            constant = c[i, k]
            if i == 0:
                for j in range(nx):
                    constant += A[0, k, j] * x0[j]
            lower[i * nx + k] = upper[i * nx + k] = constant / state_size[k]
    return (
        infinity_norm(q)
        + infinity_norm(lower)
        + infinity_norm(upper)
        + infinity_norm(P_data)
        + infinity_norm(A_data)
    )


@compiled
def _scatter(
    entries: Array, sources: _Places, factors: Array, places: _Places, data: Array
) -> None:
    """Write some of the entries, times their factors, to their places."""
    for k in range(len(sources)):
        data[places[k]] = factors[k] * entries[sources[k]]


def _assemble(
    blocks: list[tuple[Mask, int, int]], *, shape: tuple[int, int]
) -> tuple[sp.csc_matrix, _Places]:
    """Return the matrix of the blocks' pattern, full of zeros, and where each entry's data is.

    Entries are listed one block after another. SciPy would drop explicit zeros, so the numbering
    travels through the conversion as data, counted from one.
    """
    rows, columns = [], []
    for mask, row, column in blocks:
        block_rows, block_columns = np.nonzero(mask)
        rows.append(block_rows + row)
        columns.append(block_columns + column)
    row_index, column_index = np.concatenate(rows), np.concatenate(columns)
    numbering = np.arange(1.0, len(row_index) + 1.0)
    matrix = sp.csc_matrix((numbering, (row_index, column_index)), shape=shape)
    matrix.sort_indices()
    places = np.empty(len(row_index), dtype=np.intp)
    places[matrix.data.astype(np.intp) - 1] = np.arange(len(row_index))
    matrix.data[:] = 0.0
    return matrix, places
