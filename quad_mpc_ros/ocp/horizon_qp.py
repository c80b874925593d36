"""The horizon as a sparse quadratic program with a fixed pattern::

    minimise    sum_{i=1..N}   1/2 x_i' H_i x_i + g_i' x_i
              + sum_{i=0..N-1} 1/2 u_i' R_i u_i + r_i' u_i
    subject to  x_{i+1} = A_i x_i + B_i u_i + c_i,   lower_i <= u_i <= upper_i,   x_0 given

x_0 is a constant and is not a variable. The variables are interleaved, (u_0, x_1, u_1, x_2, ...),
so that the problem is banded. They are divided by their natural size and each dynamics row by
the size of its state: without that OSQP needs up to ten times the iterations and returns inputs
wrong by a third of their range.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from quad_mpc_ros.compilation import compiled
from quad_mpc_ros.lie import Array, kernels
from quad_mpc_ros.ocp.stages import HorizonPattern, HorizonStages, Mask


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
        self._sizes = np.concatenate((size, state))
        count = n * (nx + nu)
        self.A, A_places = _assemble(self._constraint_blocks(), shape=(count, count))
        self.P, P_places = _assemble(self._cost_blocks(), shape=(count, count))
        self._vectors = np.zeros((3, count))
        self.q, self.lower, self.upper = self._vectors

        count_A, count_B = (n - 1) * int(pattern.A.sum()), n * int(pattern.B.sum())
        self.A.data[A_places[count_A + count_B :]] = 1.0  # next states and bounded inputs
        count_H = n * int(np.triu(pattern.H).sum())
        width = nx + nu + 1
        self._from_A = _entries(
            n, pattern.A, -state / state[:, None], A_places[:count_A], width=width, skipped=1
        )
        self._from_B = _entries(
            n,
            pattern.B,
            -size / state[:, None],
            A_places[count_A : count_A + count_B],
            width=width,
            column=nx,
        )
        self._from_H = _entries(
            n, np.triu(pattern.H), state * state[:, None], P_places[:count_H], width=nx + 1
        )
        self._places_R = P_places[count_H:]

    def update(self, stages: HorizonStages) -> None:
        """Write the numbers of a horizon; shapes as in :class:`HorizonStages`."""
        expected = self._n, self._nx, self._nu
        if stages.shape != expected:
            # Compiled code does not look where it writes.
            raise ValueError(f"stages of shape {stages.shape}, expected {expected}")
        self._from_A.write(stages.dynamics, into=self.A.data)
        self._from_B.write(stages.dynamics, into=self.A.data)
        self._from_H.write(stages.state_cost, into=self.P.data)
        _write_vectors(
            x0=stages.x0,
            dynamics=stages.dynamics,
            state_cost=stages.state_cost,
            input_terms=stages.input_terms,
            sizes=self._sizes,
            places_R=self._places_R,
            P_data=self.P.data,
            vectors=self._vectors,
        )

    def magnitude(self) -> float:
        """Return a number at least as large as each of the problem's; NaN when one is NaN."""
        return _infinity_norm(self._vectors, self.A.data, self.P.data)

    def split(self, z: Array) -> tuple[Array, Array]:
        """Return inputs (N, nu) and states 1 to N (N, nx) of a solution, in physical units."""
        inputs, states = np.empty((self._n, self._nu)), np.empty((self._n, self._nx))
        _split(z, self._sizes, inputs=inputs, states=states)
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


class _Entries(NamedTuple):
    """Entries of a block of stages: where they are in it, their factors, and where they go."""

    sources: _Places
    factors: Array
    places: _Places

    def write(self, block: Array, *, into: Array) -> None:
        """Write the entries of a block, times their factors, to their places."""
        _scatter(
            block=block,
            sources=self.sources,
            factors=self.factors,
            places=self.places,
            data=into,
        )


def _entries(
    steps: int,
    mask: Mask,
    scale: Array,
    places: _Places,
    *,
    width: int,
    column: int = 0,
    skipped: int = 0,
) -> _Entries:
    """Return the masked entries of all stages of a block but the first ``skipped``.

    A stage's block has rows of ``width`` entries, the mask begins at a ``column`` of it.
    """
    rows, columns = np.nonzero(mask)
    in_stage = rows * width + column + columns
    sources = np.arange(skipped, steps)[:, None] * (len(mask) * width) + in_stage
    return _Entries(sources.ravel(), np.tile(scale[rows, columns], steps - skipped), places)


@compiled
def _split(z: Array, sizes: Array, inputs: Array, states: Array) -> None:
    nu, nx = inputs.shape[1], states.shape[1]
    for i in range(len(inputs)):
        first = i * (nu + nx)
        for k in range(nu):
            inputs[i, k] = z[first + k] * sizes[k]
        for k in range(nx):
            states[i, k] = z[first + nu + k] * sizes[nu + k]


@compiled
def _scatter(block: Array, sources: _Places, factors: Array, places: _Places, data: Array) -> None:
    """Write some of a block's entries, times their factors, to their places."""
    entries = block.reshape(-1)
    for k in range(len(sources)):
        data[places[k]] = factors[k] * entries[sources[k]]


@compiled
def _write_vectors(
    x0: Array,
    dynamics: Array,
    state_cost: Array,
    input_terms: Array,
    sizes: Array,
    places_R: _Places,
    P_data: Array,
    vectors: Array,
) -> None:
    """Write R, linear cost, right sides of the dynamics and bounds, all scaled."""
    q, lower, upper = vectors[0], vectors[1], vectors[2]
    n, nx, nu = len(dynamics), len(x0), input_terms.shape[2]
    for i in range(n):
        for k in range(nu):
            size, bound = sizes[k], n * nx + i * nu + k
            R, r = input_terms[i, 0, k], input_terms[i, 1, k]
            least, most = input_terms[i, 2, k], input_terms[i, 3, k]
            P_data[places_R[i * nu + k]] = R * size * size
            q[i * (nu + nx) + k] = r * size
            lower[bound], upper[bound] = least / size, most / size
        for k in range(nx):
            size = sizes[nu + k]
            q[i * (nu + nx) + nu + k] = state_cost[i, k, nx] * size
            constant = dynamics[i, k, nx + nu]
            if i == 0:
                for j in range(nx):
                    constant += dynamics[0, k, j] * x0[j]
            lower[i * nx + k] = upper[i * nx + k] = constant / size


@compiled
def _infinity_norm(vectors: Array, A_data: Array, P_data: Array) -> float:
    return (
        kernels.infinity_norm(vectors.reshape(-1))
        + kernels.infinity_norm(A_data)
        + kernels.infinity_norm(P_data)
    )


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
