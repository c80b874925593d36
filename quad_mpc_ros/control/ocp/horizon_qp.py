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

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.configuration.records import Record, RecordArray
from quad_mpc_ros.control.lie import Array, kernels
from quad_mpc_ros.control.ocp.stages import HorizonPattern, HorizonStages, LimitPattern, Mask

# A bound that holds nothing; OSQP's own infinity is beyond what a solver here may be given.
FREE = 1e9

# Found on jumps of the reference, with soft rows: bounds on inputs as loose as this take a third
# of the iterations.
_INPUT_ROW = 0.3

_Places = NDArray[np.intp]


class HorizonSolution(NamedTuple):
    """A solution in physical units: ``inputs`` (N, nu) and ``states`` 1 to N (N, nx).

    ``finite`` says whether all its numbers are, multipliers as well.
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
        self.q, self.lower, self.upper = np.zeros(columns), np.zeros(rows), np.zeros(rows)
        self._numbers = QpNumbers(self.P.data, self.q, self.A.data, self.lower, self.upper)
        self._checked: HorizonStages | None = None
        self._multipliers = np.zeros(rows)
        self.cost_scale = 1.0
        """Factor on the cost as it stands, and so on the multipliers; 1 without soft rows."""
        self.magnitude = 0.0
        """A number at least as large as each of the problem's; NaN when one is NaN."""

        count_A, count_B = (n - 1) * int(pattern.A.sum()), n * int(pattern.B.sum())
        fixed = count_A + count_B + n * (nx + nu + ns)
        # Next states, bounded inputs and slacks.
        self.A.data[A_places[count_A + count_B : fixed]] = 1.0
        count_H = n * int(np.triu(pattern.H).sum())
        at_B, at_soft = A_places[count_A : count_A + count_B], A_places[fixed:]
        self._scatter = _Scatter(
            A=_entries(pattern.A, -state / state[:, None], A_places[:count_A], n, skip=1),
            B=_entries(pattern.B, -size / state[:, None], at_B, n),
            H=_entries(np.triu(pattern.H), state * state[:, None], P_places[:count_H], n),
            normals=self._soft_entries(soft, at_soft),
            diagonal=P_places[count_H:],  # those of R, and of the quadratic prices of slacks
        )
        if nr > 0:
            inputs = slice(count_A + count_B + n * nx, count_A + count_B + n * (nx + nu))
            self.A.data[A_places[inputs]] = _INPUT_ROW
            self.lower[n * (nx + nu) :], self.upper[n * (nx + nu) :] = -FREE, FREE
            self.lower[n * (nx + nu + nr) :] = 0.0

    def _soft_entries(self, soft: LimitPattern, places: _Places) -> RecordArray[_Entry]:
        """Return the entries of the soft rows, whose places and their slacks' are given."""
        n, nu = self._n, self._nu
        before, own = soft.mask.copy(), soft.mask.copy()
        before[:, nu:], own[:, :nu] = False, False
        sizes = np.concatenate((self._sizes[:nu], self._sizes[: nu + self._nx]))
        factors = sizes / self._row_sizes[:, None]
        count_before, count_own = (n - 1) * int(before.sum()), n * int(own.sum())
        entries = _Entry.zeros(count_before + count_own)
        at_own = places[count_before : len(entries)]
        entries[:count_before] = _entries(before, factors, places[:count_before], n, skip=1)
        entries[count_before:] = _entries(own, factors, at_own, n)
        self.A.data[places[len(entries) :]] = -1.0
        return entries

    def update(self, stages: HorizonStages) -> None:
        """Write the numbers of a horizon; shapes as in :class:`HorizonStages`."""
        if stages is not self._checked:
            self._check_sizes(stages)
        self.cost_scale, self.magnitude = _write(
            stages,
            scatter=self._scatter,
            sizes=self._sizes,
            row_sizes=self._row_sizes,
            numbers=self._numbers,
        )

    def _check_sizes(self, stages: HorizonStages) -> None:
        """Refuse other sizes: compiled code does not look where it writes."""
        given, expected = stages.sizes, (self._n, self._nx, self._nu, self._nr, self._ns)
        if given != expected:
            raise ValueError(
                "steps, states, inputs, soft rows and slacks of the stages: "
                f"{given}, expected {expected}"
            )
        self._checked = stages

    @property
    def is_soft(self) -> bool:
        """Whether there are soft rows."""
        return self._nr > 0

    @property
    def first_soft_row(self) -> int:
        """The first row of those that are soft; bounds on their slacks follow, to the end."""
        return self._n * (self._nx + self._nu)

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


class QpNumbers(NamedTuple):
    """The numbers of OSQP's form: entries of ``P`` and ``A``, and its vectors."""

    P: Array
    q: Array
    A: Array
    lower: Array
    upper: Array


class _Entry(Record):
    """A number of the stages that becomes one of a matrix."""

    source: int  # where it is in its block of all stages, flat
    place: int  # where it goes in the matrix
    factor: float


class _Scatter(NamedTuple):
    """Where the blocks of the stages go in the matrices."""

    A: RecordArray[_Entry]
    B: RecordArray[_Entry]
    H: RecordArray[_Entry]
    normals: RecordArray[_Entry]
    diagonal: _Places


def _entries(
    mask: Mask, factors: Array, places: _Places, steps: int, *, skip: int = 0
) -> RecordArray[_Entry]:
    """Return the masked entries of a block (rows, columns) of each stage but the first few."""
    flat = np.flatnonzero(mask)
    entries = _Entry.zeros((steps - skip) * len(flat))
    stages = np.arange(skip, steps)[:, None]
    entries["source"] = (stages * mask.size + flat).ravel()
    entries["place"] = places
    entries["factor"] = np.tile(np.broadcast_to(factors, mask.shape).ravel()[flat], steps - skip)
    return entries


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
    stages: HorizonStages, scatter: _Scatter, sizes: Array, row_sizes: Array, numbers: QpNumbers
) -> tuple[float, float]:
    """Write the numbers of the QP; return the factor on its cost, and their magnitude."""
    _scatter(stages.A, scatter.A, numbers.A)
    _scatter(stages.B, scatter.B, numbers.A)
    _scatter(stages.H, scatter.H, numbers.P)
    _write_dynamics(stages, sizes, numbers)
    _write_inputs(stages, sizes, scatter.diagonal, numbers)
    if len(row_sizes) == 0:
        return 1.0, _magnitude(numbers)
    _scatter(stages.normals, scatter.normals, numbers.A)
    _write_limits(stages, sizes, row_sizes, scatter.diagonal, numbers)
    factor = 1.0 / max(1.0, kernels.infinity_norm(numbers.q))
    for k in range(len(numbers.q)):
        numbers.q[k] *= factor
    for k in range(len(numbers.P)):
        numbers.P[k] *= factor
    return factor, _magnitude(numbers)


@compiled
def _scatter(block: Array, entries: RecordArray[_Entry], matrix: Array) -> None:
    """Write entries of a block of the stages into a matrix's data."""
    values = block.reshape(block.size)
    for k in range(len(entries)):
        entry = entries[k]
        matrix[entry.place] = entry.factor * values[entry.source]


@compiled
def _magnitude(numbers: QpNumbers) -> float:
    """Return the largest magnitude of all; NaN when one is NaN."""
    cost = kernels.infinity_norm(numbers.P), kernels.infinity_norm(numbers.q)
    rows = kernels.infinity_norm(numbers.lower), kernels.infinity_norm(numbers.upper)
    A = kernels.infinity_norm(numbers.A)
    total = cost[0] + cost[1] + rows[0] + rows[1] + A
    return total if math.isnan(total) else max(cost[0], cost[1], rows[0], rows[1], A)


@compiled
def _write_dynamics(stages: HorizonStages, sizes: Array, numbers: QpNumbers) -> None:
    """Write the right sides of the dynamics, and the linear cost of states."""
    n, nx, nu = stages.B.shape
    for i in range(n):
        for k in range(nx):
            size = sizes[nu + k]
            numbers.q[i * len(sizes) + nu + k] = stages.g[i, k] * size
            constant = stages.c[i, k]
            if i == 0:
                for j in range(nx):
                    constant += stages.A[0, k, j] * stages.x0[j]
            numbers.lower[i * nx + k] = numbers.upper[i * nx + k] = constant / size


@compiled
def _write_inputs(
    stages: HorizonStages, sizes: Array, diagonal: _Places, numbers: QpNumbers
) -> None:
    """Write the cost of inputs, and their bounds."""
    n, nx, nu = stages.B.shape
    for i in range(n):
        for k in range(nu):
            size, bound = sizes[k], n * nx + i * nu + k
            numbers.P[diagonal[i * nu + k]] = stages.R[i, k] * size * size
            numbers.q[i * len(sizes) + k] = stages.r[i, k] * size
            numbers.lower[bound] = stages.lower[i, k] / size
            numbers.upper[bound] = stages.upper[i, k] / size


@compiled
def _write_limits(
    stages: HorizonStages,
    sizes: Array,
    row_sizes: Array,
    diagonal: _Places,
    numbers: QpNumbers,
) -> None:
    """Write the bounds of soft rows and the prices of slacks."""
    n, nr, ns, width = len(stages.R), len(row_sizes), stages.linear.shape[1], len(sizes)
    first, nu = n * (width - ns), stages.R.shape[1]
    for k in range(first - n * nu, first):
        numbers.lower[k] *= _INPUT_ROW
        numbers.upper[k] *= _INPUT_ROW
    for i in range(n):
        for j in range(nr):
            bound = stages.offsets[i, j] / row_sizes[j]
            numbers.upper[first + i * nr + j] = min(bound, FREE)
        for k in range(ns):
            size = sizes[width - ns + k]
            numbers.q[i * width + width - ns + k] = stages.linear[i, k] * size
            price = stages.quadratic[i, k] * size * size
            numbers.P[diagonal[n * nu + i * ns + k]] = price


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
    places = [np.nonzero(mask) for mask, _, _ in blocks]
    rows = np.concatenate([at[0] + row for at, (_, row, _) in zip(places, blocks, strict=True)])
    columns = np.concatenate([at[1] + col for at, (_, _, col) in zip(places, blocks, strict=True)])
    in_data = np.empty(len(rows), np.intp)
    in_data[np.lexsort((rows, columns))] = np.arange(len(rows))
    indices = rows.astype(np.int32), columns.astype(np.int32)
    return sparse.csc_matrix((np.zeros(len(rows)), indices), shape), in_data
