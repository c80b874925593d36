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

from quad_mpc_ros.core.compiled import compiled, largest
from quad_mpc_ros.core.messages import Array

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
        n, nx, nu = pattern.steps, len(pattern.state_size), len(pattern.input_size)
        self._n, self._nx, self._nu = n, nx, nu
        self._shape = n, nx, nu
        state, size = pattern.state_size, pattern.input_size
        self._parts_A = _part(pattern.A, -state / state[:, None])
        self._parts_B = _part(pattern.B, -size / state[:, None])
        self._parts_H = _part(np.triu(pattern.H), state * state[:, None])

        self.A, self._A_slots, self._A_entries = _assemble(
            self._constraint_blocks(), shape=(n * (nx + nu), n * (nx + nu))
        )
        self.P, self._P_slots, self._P_entries = _assemble(
            self._cost_blocks(), shape=(n * (nx + nu), n * (nx + nu))
        )
        self.q = np.zeros(n * (nx + nu))
        self.lower = np.zeros(n * (nx + nu))
        self.upper = np.zeros(n * (nx + nu))
        self._views()

    def update(self, stages: HorizonStages) -> None:
        """Write the numbers of a horizon; shapes as in :class:`HorizonStages`."""
        if stages.B.shape != self._shape:
            # Compiled code does not look where it writes.
            raise ValueError(f"stages of shape {stages.B.shape}, expected {self._shape}")
        _gather(stages.A[1:], *self._parts_A, self._entries_A)
        _gather(stages.B, *self._parts_B, self._entries_B)
        _gather(stages.H, *self._parts_H, self._entries_H)
        _write_vectors(
            stages.x0,
            stages.A[0],
            stages.c,
            stages.g,
            stages.R,
            stages.r,
            stages.lower,
            stages.upper,
            self.pattern.state_size,
            self.pattern.input_size,
            self._entries_R,
            self.q,
            self.lower,
            self.upper,
        )
        np.take(self._A_entries, self._A_slots, out=self.A.data)
        np.take(self._P_entries, self._P_slots, out=self.P.data)

    def size(self) -> float:
        """Return a number at least as large as each of the problem's; NaN when one is NaN."""
        parts = (self.q, self.lower, self.upper, self.P.data, self.A.data)
        return sum(map(largest, parts))

    def split(self, z: Array) -> tuple[Array, Array]:
        """Return inputs (N, nu) and states 1 to N (N, nx) of a solution, in physical units."""
        stages = z.reshape(self._n, self._nu + self._nx)
        return (
            stages[:, : self._nu] * self.pattern.input_size,
            stages[:, self._nu :] * self.pattern.state_size,
        )

    def _views(self) -> None:
        """Name the parts of the entry lists that change."""
        n, nu = self._n, self._nu
        count_A = (n - 1) * int(self.pattern.A.sum())
        count_B = n * int(self.pattern.B.sum())
        self._entries_A = self._A_entries[:count_A].reshape(n - 1, int(self.pattern.A.sum()))
        self._entries_B = self._A_entries[count_A : count_A + count_B].reshape(n, -1)
        self._A_entries[count_A + count_B :] = 1.0  # next states and bounded inputs

        count_H = n * len(self._parts_H[0])
        self._entries_H = self._P_entries[:count_H].reshape(n, -1)
        self._entries_R = self._P_entries[count_H:].reshape(n, nu)

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


_Part = tuple[NDArray[np.intp], NDArray[np.intp], Array]


def _part(mask: Mask, scale: Array) -> _Part:
    """Return rows, columns and factors of a mask's entries."""
    rows, columns = np.nonzero(mask)
    return rows, columns, scale[rows, columns]


@compiled
def _gather(
    matrices: Array,
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    factors: Array,
    entries: Array,
) -> None:
    """Write the chosen entries of matrices (n, ., .), times their factors, into (n, entries)."""
    for i in range(len(matrices)):
        for k in range(len(rows)):
            entries[i, k] = factors[k] * matrices[i, rows[k], columns[k]]


@compiled
def _write_vectors(
    x0: Array,
    A_first: Array,
    c: Array,
    g: Array,
    R: Array,
    r: Array,
    least: Array,
    most: Array,
    state_size: Array,
    input_size: Array,
    entries_R: Array,
    q: Array,
    lower: Array,
    upper: Array,
) -> None:
    """Write the linear cost, the right sides of the dynamics and the bounds, all scaled."""
    n, nx = g.shape
    nu = r.shape[1]
    for i in range(n):
        for k in range(nu):
            size, bound = input_size[k], n * nx + i * nu + k
            entries_R[i, k] = R[i, k] * size * size
            q[i * (nu + nx) + k] = r[i, k] * size
            lower[bound], upper[bound] = least[i, k] / size, most[i, k] / size
        for k in range(nx):
            q[i * (nu + nx) + nu + k] = g[i, k] * state_size[k]
            constant = c[i, k]
            if i == 0:
                for j in range(nx):
                    constant += A_first[k, j] * x0[j]
            lower[i * nx + k] = upper[i * nx + k] = constant / state_size[k]


def _assemble(
    blocks: list[tuple[Mask, int, int]], *, shape: tuple[int, int]
) -> tuple[sp.csc_matrix, NDArray[np.intp], Array]:
    """Return the matrix of the blocks' pattern, and where each of its data comes from.

    ``matrix.data[k]`` is to be ``entries[slots[k]]``, where ``entries`` lists the blocks' masked
    entries one block after another. SciPy would drop explicit zeros, so the numbering travels
    through the conversion as data, counted from one.
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
    slots = matrix.data.astype(np.intp) - 1
    return matrix, slots, np.zeros(len(row_index))
