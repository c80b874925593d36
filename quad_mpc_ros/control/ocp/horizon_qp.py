"""The horizon as a sparse quadratic program with a fixed pattern::

    minimise    sum_{i=1..N}   1/2 x_i' H_i x_i + g_i' x_i
              + sum_{i=0..N-1} 1/2 u_i' R_i u_i + r_i' u_i
              + sum_{i=0..N-1} c_i' s_i + 1/2 s_i' D_i s_i
    subject to  x_{i+1} = A_i x_i + B_i u_i + c_i,   lower_i <= u_i <= upper_i,   x_0 given
                n_ij' (u_{i-1}, u_i, x_{i+1}) - s_i,k(j) <= b_ij,   s_i >= 0

x_0 is a constant and is not a variable. The variables are interleaved, (u_0, x_1, s_0, u_1, x_2,
s_1, ...), so that the problem is banded. They are divided by their natural size and each dynamics
row by the size of its state: without that OSQP needs up to ten times the iterations and returns
inputs wrong by a third of their range. Without soft rows there are no slacks, and nothing of them
is in the matrices.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.ocp.stages import (
    HorizonPattern,
    HorizonStages,
    LimitPattern,
    Mask,
    Shape,
    StageParts,
    stages_in,
)

# A bound that holds nothing; OSQP's own infinity is beyond what a solver here may be given.
FREE = 1e9

# Found on jumps of the reference, with soft rows: bounds on inputs as loose as this take a third
# of the iterations.
_INPUT_ROW = 0.3

_Places = NDArray[np.intp]


class HorizonSolution(NamedTuple):
    """A solution in physical units: ``inputs`` (N, nu) and ``states`` 1 to N (N, nx).

    ``finite`` tells whether all its numbers are, multipliers as well.
    """

    finite: bool
    inputs: Array
    states: Array


class HorizonQP:
    """OSQP's form ``min 1/2 z'Pz + q'z, l <= Az <= u`` of a horizon, updated in place.

    ``P`` (upper triangle) and ``A`` keep their pattern for life; :meth:`update` writes into their
    data and into ``q``, ``l``, ``u`` without allocating matrices.
    """

    def __init__(self, pattern: HorizonPattern) -> None:
        self.pattern = pattern
        state, size, soft = pattern.state_size, pattern.input_size, pattern.soft
        n, nx, nu = pattern.steps, len(state), len(size)
        nr, ns = len(soft.mask), len(soft.slack_size)
        self._n, self._nx, self._nu, self._nr, self._ns = n, nx, nu, nr, ns
        self._sizes = np.concatenate((size, state, soft.slack_size))
        self._slack_of = soft.slack_of
        self._row_sizes = soft.slack_size[soft.slack_of]
        columns, rows = n * (nx + nu + ns), n * (nx + nu + nr + ns)
        self.A, A_places = _assemble(self._constraint_blocks(), shape=(rows, columns))
        self.P, P_places = _assemble(self._cost_blocks(), shape=(columns, columns))
        # One array, for compiled code: first what the cost is of.
        self._cost_size = at_A = columns + self.P.nnz
        self._numbers = np.zeros(at_A + self.A.nnz + 2 * rows)
        self.q, self.P.data, self.A.data, self.lower, self.upper = np.split(
            self._numbers, np.cumsum([columns, self.P.nnz, self.A.nnz, rows])
        )
        self._multipliers = np.zeros(rows)
        self.cost_scale = 1.0
        """Factor on the cost as it stands, and so on the multipliers; 1 without soft rows."""
        self.magnitude = 0.0
        """A number at least as large as each of the problem's; NaN when one is NaN."""

        stages = HorizonStages.zeros(n, nx, nu, rows=nr, slacks=ns)
        self._shape, self._given = stages.shape, tuple(stages.shape.tolist())
        # Where the numbers of the stages are in their buffer.
        numbering = dataclasses.replace(stages, buffer=np.arange(float(len(stages.buffer))))
        count_A, count_B = (n - 1) * int(pattern.A.sum()), n * int(pattern.B.sum())
        fixed = count_A + count_B + n * (nx + nu + ns)
        # Next states, bounded inputs and slacks.
        self.A.data[A_places[count_A + count_B : fixed]] = 1.0
        count_H = n * int(np.triu(pattern.H).sum())
        self._entries = _Entries.all_of(
            _entries(numbering.A[1:], pattern.A, -state / state[:, None]),
            _entries(numbering.B, pattern.B, -size / state[:, None]),
            at=at_A + A_places[: count_A + count_B],
        ).and_also(
            _Entries.all_of(
                _entries(numbering.H, np.triu(pattern.H), state * state[:, None]),
                at=columns + P_places[:count_H],
            )
        )
        if nr > 0:
            inputs = slice(count_A + count_B + n * nx, count_A + count_B + n * (nx + nu))
            self.A.data[A_places[inputs]] = _INPUT_ROW
            self._set_up_limits(soft, numbering, A_places[fixed:], at=at_A)
        # Those of R, and of the quadratic prices of slacks.
        self._diagonal = columns + P_places[count_H:]

    def _set_up_limits(
        self, soft: LimitPattern, numbering: HorizonStages, places: _Places, *, at: int
    ) -> None:
        """Take the pattern of the soft rows, and the places of their entries, ``at`` on."""
        n, nx, nu, nr = self._n, self._nx, self._nu, self._nr
        before, own = soft.mask[:, :nu], soft.mask[:, nu:]
        count = (n - 1) * int(before.sum()) + n * int(own.sum())
        sizes = self._sizes[: nu + nx] / self._row_sizes[:, None]
        self._entries = self._entries.and_also(
            _Entries.all_of(
                _entries(numbering.normals[1:, :, :nu], before, sizes[:, :nu]),
                _entries(numbering.normals[:, :, nu:], own, sizes),
                at=at + places[:count],
            )
        )
        self.A.data[places[count:]] = -1.0
        self.lower[n * (nx + nu) :], self.upper[n * (nx + nu) :] = -FREE, FREE
        self.lower[n * (nx + nu + nr) :] = 0.0

    def update(self, stages: HorizonStages) -> None:
        """Write the numbers of a horizon; shapes as in :class:`HorizonStages`."""
        if stages.shape is not self._shape:
            self._check_shape(stages)
        sources, factors, places = self._entries
        self.cost_scale, self.magnitude = _write(
            shape=self._shape,
            stages=stages.buffer,
            sources=sources,
            factors=factors,
            places=places,
            diagonal=self._diagonal,
            sizes=self._sizes,
            row_sizes=self._row_sizes,
            cost_size=self._cost_size,
            numbers=self._numbers,
        )

    def _check_shape(self, stages: HorizonStages) -> None:
        """Refuse other shapes: compiled code does not look where it writes."""
        given = tuple(stages.shape.tolist())
        if given != self._given:
            raise ValueError(
                "steps, states, inputs, soft rows and slacks of the stages: "
                f"{given}, expected {self._given}"
            )
        self._shape = stages.shape

    @property
    def is_soft(self) -> bool:
        """Whether there are soft rows."""
        return self._nr > 0

    def settled(self, z: Array, y: Array) -> tuple[Array, Array]:
        """Return a start for a problem with soft rows, from variables and multipliers.

        The multipliers are of the cost itself. The slacks are what the rows ask for where all else
        is zero, written into ``z``. The multipliers of their bounds hold the prices, which change
        from one problem to the next, less what the rows pay. The next call overwrites them.
        """
        _settle(
            z=z,
            kept=y,
            cost_scale=self.cost_scale,
            y=self._multipliers,
            q=self.q,
            upper=self.upper,
            steps=self._n,
            slack_of=self._slack_of,
        )
        return z, self._multipliers

    def read(self, z: Array, y: Array) -> HorizonSolution:
        """Return a solution in physical units; multipliers become those of the cost itself."""
        inputs, states = np.empty((self._n, self._nu)), np.empty((self._n, self._nx))
        finite = _read(
            z, y=y, cost_scale=self.cost_scale, sizes=self._sizes, inputs=inputs, states=states
        )
        return HorizonSolution(finite, inputs, states)

    def slacks(self, z: Array) -> Array:
        """Return the slacks (N, ns) of a solution, in physical units."""
        width = len(self._sizes)
        return z.reshape(self._n, width)[:, width - self._ns :] * self._sizes[width - self._ns :]

    def _input_at(self, stage: int) -> int:
        return stage * (self._nu + self._nx + self._ns)

    def _state_at(self, stage: int) -> int:
        """First variable of state ``stage``, 1 to N."""
        return self._input_at(stage - 1) + self._nu

    def _slack_at(self, stage: int) -> int:
        return self._input_at(stage) + self._nu + self._nx

    def _constraint_blocks(self) -> list[tuple[Mask, int, int]]:
        """Return (mask, first row, first column) of every block, in the order of the entries."""
        n, nx, nu = self._n, self._nx, self._nu
        A, B, eye_x, eye_u = self.pattern.A, self.pattern.B, np.eye(nx) > 0, np.eye(nu) > 0
        return (
            [(A, i * nx, self._state_at(i)) for i in range(1, n)]
            + [(B, i * nx, self._input_at(i)) for i in range(n)]
            + [(eye_x, i * nx, self._state_at(i + 1)) for i in range(n)]
            + [(eye_u, n * nx + i * nu, self._input_at(i)) for i in range(n)]
            + self._limit_blocks()
        )

    def _limit_blocks(self) -> list[tuple[Mask, int, int]]:
        """Return those of the slacks' bounds and of the soft rows."""
        n, nx, nu, nr, ns = self._n, self._nx, self._nu, self._nr, self._ns
        if nr == 0:
            return []
        soft, eye_s = self.pattern.soft, np.eye(ns) > 0
        first = n * (nx + nu)
        slacks = first + n * nr
        before, own = soft.mask[:, :nu], soft.mask[:, nu:]
        return (
            [(eye_s, slacks + i * ns, self._slack_at(i)) for i in range(n)]
            + [(before, first + i * nr, self._input_at(i - 1)) for i in range(1, n)]
            + [(own, first + i * nr, self._input_at(i)) for i in range(n)]
            + [(eye_s[soft.slack_of], first + i * nr, self._slack_at(i)) for i in range(n)]
        )

    def _cost_blocks(self) -> list[tuple[Mask, int, int]]:
        n, eye_u = self._n, np.eye(self._nu) > 0
        states = [self._state_at(i) for i in range(1, n + 1)]
        inputs = [self._input_at(i) for i in range(n)]
        H_upper = np.triu(self.pattern.H)
        slacks = [(np.eye(self._ns) > 0, self._slack_at(i)) for i in range(n)] if self._ns else []
        return (
            [(H_upper, k, k) for k in states]
            + [(eye_u, k, k) for k in inputs]
            + [(eye_s, k, k) for eye_s, k in slacks]
        )


class _Entries(NamedTuple):
    """Numbers of the stages: where they are in them, their factors, and where they go."""

    sources: _Places
    factors: Array
    places: _Places

    @staticmethod
    def all_of(*blocks: tuple[_Places, Array], at: _Places) -> _Entries:
        """Return the entries of blocks, one after another, that go to places."""
        sources, factors = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
        return _Entries(sources, factors, at)

    def and_also(self, other: _Entries) -> _Entries:
        """Return these and other entries."""
        return _Entries(*(np.concatenate(parts) for parts in zip(self, other, strict=True)))


def _entries(block: Array, mask: Mask, scale: Array) -> tuple[_Places, Array]:
    """Return sources and factors of the masked entries of all stages of a block.

    The block (n, rows, columns) holds where in the buffer each of its numbers is.
    """
    rows, columns = np.nonzero(mask)
    sources = block[:, rows, columns].astype(np.intp)
    return sources.ravel(), np.tile(scale[rows, columns], len(block))


@compiled
def _read(
    z: Array, y: Array, cost_scale: float, sizes: Array, inputs: Array, states: Array
) -> bool:
    nu, nx = inputs.shape[1], states.shape[1]
    for i in range(len(inputs)):
        first = i * len(sizes)
        for k in range(nu):
            inputs[i, k] = z[first + k] * sizes[k]
        for k in range(nx):
            states[i, k] = z[first + nu + k] * sizes[nu + k]
    for k in range(len(y)):
        y[k] /= cost_scale
    return math.isfinite(kernels.infinity_norm(z)) and math.isfinite(kernels.infinity_norm(y))


@compiled
def _write(
    shape: Shape,
    stages: Array,
    sources: _Places,
    factors: Array,
    places: _Places,
    diagonal: _Places,
    sizes: Array,
    row_sizes: Array,
    cost_size: int,
    numbers: Array,
) -> tuple[float, float]:
    """Write the numbers of the QP; return the factor on its cost, and their magnitude."""
    given, n, width = stages_in(shape, stages), shape[0], len(sizes)
    for k in range(len(sources)):
        numbers[places[k]] = factors[k] * stages[sources[k]]
    q, bounds = numbers[: n * width], numbers[len(numbers) - 2 * n * (width + shape[3]) :]
    lower, upper = bounds[: len(bounds) // 2], bounds[len(bounds) // 2 :]
    _write_dynamics(given, sizes, q, lower, upper)
    _write_inputs(given, sizes, diagonal, numbers, lower, upper)
    if shape[3] == 0:
        return 1.0, kernels.infinity_norm(numbers)
    _write_limits(given, sizes, row_sizes, diagonal, numbers, lower, upper)
    factor = 1.0 / max(1.0, kernels.infinity_norm(q))
    for k in range(cost_size):
        numbers[k] *= factor
    return factor, kernels.infinity_norm(numbers)


@compiled
def _write_dynamics(given: StageParts, sizes: Array, q: Array, lower: Array, upper: Array) -> None:
    """Write the right sides of the dynamics, and the linear cost of states."""
    n, nx, nu = len(given.dynamics), len(given.x0), given.input_terms.shape[2]
    for i in range(n):
        for k in range(nx):
            size = sizes[nu + k]
            q[i * len(sizes) + nu + k] = given.state_cost[i, k, nx] * size
            constant = given.dynamics[i, k, nx + nu]
            if i == 0:
                for j in range(nx):
                    constant += given.dynamics[0, k, j] * given.x0[j]
            lower[i * nx + k] = upper[i * nx + k] = constant / size


@compiled
def _write_inputs(
    given: StageParts,
    sizes: Array,
    diagonal: _Places,
    numbers: Array,
    lower: Array,
    upper: Array,
) -> None:
    """Write the cost of inputs, and their bounds."""
    n, nx, nu = len(given.dynamics), len(given.x0), given.input_terms.shape[2]
    for i in range(n):
        for k in range(nu):
            size, bound = sizes[k], n * nx + i * nu + k
            R, r = given.input_terms[i, 0, k], given.input_terms[i, 1, k]
            least, most = given.input_terms[i, 2, k], given.input_terms[i, 3, k]
            numbers[diagonal[i * nu + k]] = R * size * size
            numbers[i * len(sizes) + k] = r * size
            lower[bound], upper[bound] = least / size, most / size


@compiled
def _write_limits(
    given: StageParts,
    sizes: Array,
    row_sizes: Array,
    diagonal: _Places,
    numbers: Array,
    lower: Array,
    upper: Array,
) -> None:
    """Write the bounds of soft rows and the prices of slacks."""
    n, nr, ns, width = len(given.limits), len(row_sizes), given.slack_cost.shape[1], len(sizes)
    first, nu = n * (width - ns), given.input_terms.shape[2]
    for k in range(first - n * nu, first):
        lower[k] *= _INPUT_ROW
        upper[k] *= _INPUT_ROW
    for i in range(n):
        for j in range(nr):
            bound = given.limits[i, j, given.limits.shape[2] - 1] / row_sizes[j]
            upper[first + i * nr + j] = min(bound, FREE)
        for k in range(ns):
            size = sizes[width - ns + k]
            numbers[i * width + width - ns + k] = given.slack_cost[i, k, 0] * size
            numbers[diagonal[n * nu + i * ns + k]] = given.slack_cost[i, k, 1] * size * size


@compiled
def _settle(
    z: Array,
    kept: Array,
    cost_scale: float,
    y: Array,
    q: Array,
    upper: Array,
    steps: int,
    slack_of: _Places,
) -> None:
    for k in range(len(y)):
        y[k] = cost_scale * kept[k]
    nr, ns, width = len(slack_of), slack_of[-1] + 1, len(z) // steps
    rows = steps * (width - ns)
    bounds = rows + steps * nr
    for i in range(steps):
        for k in range(ns):
            slack, bound = i * width + width - ns + k, bounds + i * ns + k
            z[slack], y[bound] = 0.0, -q[slack]
            for j in range(nr):
                if slack_of[j] == k:
                    row = rows + i * nr + j
                    z[slack] = max(z[slack], -upper[row])
                    y[bound] += y[row]
            y[bound] = min(y[bound], 0.0)


def _assemble(
    blocks: list[tuple[Mask, int, int]], *, shape: tuple[int, int]
) -> tuple[sparse.csc_matrix, _Places]:
    """Return the matrix of the blocks' pattern, full of zeros, and where each entry's data is.

    Entries are listed one block after another, and each is given once. SciPy sorts them by column
    and row, and keeps zeros that are given.
    """
    rows, columns = [], []
    for mask, row, column in blocks:
        block_rows, block_columns = np.nonzero(mask)
        rows.append(block_rows + row)
        columns.append(block_columns + column)
    row, column = np.concatenate(rows), np.concatenate(columns)
    places = np.empty(len(row), np.intp)
    places[np.lexsort((row, column))] = np.arange(len(row))
    zeros = np.zeros(len(row))
    matrix = sparse.csc_matrix((zeros, (row.astype(np.int32), column.astype(np.int32))), shape)
    return matrix, places
