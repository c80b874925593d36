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

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from quad_mpc_ros.compilation import compiled
from quad_mpc_ros.lie import Array, kernels
from quad_mpc_ros.ocp.stages import HorizonPattern, HorizonStages, LimitPattern, Mask

# A bound that holds nothing; OSQP's own infinity is beyond what a solver here may be given.
FREE = 1e9

# Found on jumps of the reference, with soft rows: bounds on inputs as loose as this take a third
# of the iterations.
_INPUT_ROW = 0.3

_Places = NDArray[np.intp]


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
        self.q, self._bounds = np.zeros(columns), np.zeros((2, rows))
        self.lower, self.upper = self._bounds
        self.cost_scale = 1.0
        """Factor on the cost as it stands, and so on the multipliers; 1 without soft rows."""

        count_A, count_B = (n - 1) * int(pattern.A.sum()), n * int(pattern.B.sum())
        fixed = count_A + count_B + n * (nx + nu + ns)
        # Next states, bounded inputs and slacks.
        self.A.data[A_places[count_A + count_B : fixed]] = 1.0
        if nr > 0:
            inputs = slice(count_A + count_B + n * nx, count_A + count_B + n * (nx + nu))
            self.A.data[A_places[inputs]] = _INPUT_ROW
            self._set_up_limits(soft, A_places[fixed:])
        count_H = n * int(np.triu(pattern.H).sum())
        width = nx + nu + 1
        self._from_dynamics = _entries(
            n, pattern.A, -state / state[:, None], A_places[:count_A], width=width, skipped=1
        ).and_also(
            _entries(
                n,
                pattern.B,
                -size / state[:, None],
                A_places[count_A : count_A + count_B],
                width=width,
                column=nx,
            )
        )
        self._from_H = _entries(
            n, np.triu(pattern.H), state * state[:, None], P_places[:count_H], width=nx + 1
        )
        self._places_R = P_places[count_H : count_H + n * nu]
        self._places_D = P_places[count_H + n * nu :]

    def _set_up_limits(self, soft: LimitPattern, places: _Places) -> None:
        """Take the pattern of the soft rows, and the places of their entries."""
        n, nx, nu, nr = self._n, self._nx, self._nu, self._nr
        before, own = soft.mask[:, :nu], soft.mask[:, nu:]
        first, count = (n - 1) * int(before.sum()), n * int(own.sum())
        width, sizes = 2 * nu + nx + 1, self._sizes[: nu + nx] / self._row_sizes[:, None]
        self._from_limits = _entries(
            n, before, sizes[:, :nu], places[:first], width=width, skipped=1
        ).and_also(_entries(n, own, sizes, places[first : first + count], width=width, column=nu))
        self.A.data[places[first + count :]] = -1.0
        self._bounds[:, n * (nx + nu) :] = np.array([[-FREE], [FREE]])
        self.lower[n * (nx + nu + nr) :] = 0.0

    def update(self, stages: HorizonStages) -> None:
        """Write the numbers of a horizon; shapes as in :class:`HorizonStages`."""
        expected = self._n, self._nx, self._nu
        if stages.shape != expected:
            # Compiled code does not look where it writes.
            raise ValueError(f"stages of shape {stages.shape}, expected {expected}")
        if stages.soft_shape != (self._nr, self._ns):
            raise ValueError(
                f"{stages.soft_shape} soft rows and slacks, expected {(self._nr, self._ns)}"
            )
        self._from_dynamics.write(stages.dynamics, into=self.A.data)
        self._from_H.write(stages.state_cost, into=self.P.data)
        _write_vectors(
            x0=stages.x0,
            dynamics=stages.dynamics,
            state_cost=stages.state_cost,
            input_terms=stages.input_terms,
            sizes=self._sizes,
            places_R=self._places_R,
            P_data=self.P.data,
            q=self.q,
            bounds=self._bounds,
        )
        if self._nr > 0:
            self._from_limits.write(stages.limits, into=self.A.data)
            _write_limits(
                limits=stages.limits,
                slack_cost=stages.slack_cost,
                row_sizes=self._row_sizes,
                sizes=self._sizes,
                places_D=self._places_D,
                P_data=self.P.data,
                q=self.q,
                bounds=self._bounds,
            )
            self.cost_scale = _normalise(self.P.data, self.q)

    @property
    def is_soft(self) -> bool:
        """Whether there are soft rows."""
        return self._nr > 0

    def magnitude(self) -> float:
        """Return a number at least as large as each of the problem's; NaN when one is NaN."""
        return _infinity_norm(self.q, self._bounds, self.A.data, self.P.data)

    def settle_slacks(self, z: Array, y: Array) -> None:
        """Write the slacks of a start, into variables that are otherwise zero and multipliers.

        The slacks are what the rows ask for at zero. The multipliers of their bounds hold the
        prices, which change from one problem to the next, less what the rows pay.
        """
        if self._nr > 0:
            _settle_slacks(z, y, self.q, self.upper, steps=self._n, slack_of=self._slack_of)

    def split(self, z: Array) -> tuple[Array, Array]:
        """Return inputs (N, nu) and states 1 to N (N, nx) of a solution, in physical units."""
        inputs, states = np.empty((self._n, self._nu)), np.empty((self._n, self._nx))
        _split(z, self._sizes, inputs=inputs, states=states)
        return inputs, states

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
    """Entries of a block of stages: where they are in it, their factors, and where they go."""

    sources: _Places
    factors: Array
    places: _Places

    def and_also(self, other: _Entries) -> _Entries:
        """Return these and other entries of the same block."""
        return _Entries(*(np.concatenate(parts) for parts in zip(self, other, strict=True)))

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
        first = i * len(sizes)
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
    q: Array,
    bounds: Array,
) -> None:
    """Write R, linear cost, right sides of the dynamics and bounds, all scaled."""
    lower, upper, width = bounds[0], bounds[1], len(sizes)
    n, nx, nu = len(dynamics), len(x0), input_terms.shape[2]
    for i in range(n):
        for k in range(nu):
            size, bound = sizes[k], n * nx + i * nu + k
            R, r = input_terms[i, 0, k], input_terms[i, 1, k]
            least, most = input_terms[i, 2, k], input_terms[i, 3, k]
            P_data[places_R[i * nu + k]] = R * size * size
            q[i * width + k] = r * size
            lower[bound], upper[bound] = least / size, most / size
        for k in range(nx):
            size = sizes[nu + k]
            q[i * width + nu + k] = state_cost[i, k, nx] * size
            constant = dynamics[i, k, nx + nu]
            if i == 0:
                for j in range(nx):
                    constant += dynamics[0, k, j] * x0[j]
            lower[i * nx + k] = upper[i * nx + k] = constant / size


@compiled
def _write_limits(
    limits: Array,
    slack_cost: Array,
    row_sizes: Array,
    sizes: Array,
    places_D: _Places,
    P_data: Array,
    q: Array,
    bounds: Array,
) -> None:
    """Write the bounds of soft rows and the prices of slacks, scaled."""
    n, nr, ns, width = len(limits), len(row_sizes), slack_cost.shape[1], len(sizes)
    first, upper = n * (width - ns), bounds[1]
    nu = limits.shape[2] - 1 - (width - ns)
    for k in range(first - n * nu, first):
        bounds[0, k] *= _INPUT_ROW
        bounds[1, k] *= _INPUT_ROW
    for i in range(n):
        for j in range(nr):
            bound = limits[i, j, limits.shape[2] - 1] / row_sizes[j]
            upper[first + i * nr + j] = min(bound, FREE)
        for k in range(ns):
            slack = width - ns + k
            size = sizes[slack]
            q[i * width + slack] = slack_cost[i, k, 0] * size
            P_data[places_D[i * ns + k]] = slack_cost[i, k, 1] * size * size


@compiled
def _settle_slacks(
    z: Array, y: Array, q: Array, upper: Array, steps: int, slack_of: _Places
) -> None:
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


@compiled
def _normalise(P_data: Array, q: Array) -> float:
    """Divide a cost by its largest slope where that is above one; return the factor."""
    factor = 1.0 / max(1.0, kernels.infinity_norm(q))
    for k in range(len(P_data)):
        P_data[k] *= factor
    for k in range(len(q)):
        q[k] *= factor
    return factor


@compiled
def _infinity_norm(q: Array, bounds: Array, A_data: Array, P_data: Array) -> float:
    return (
        kernels.infinity_norm(q)
        + kernels.infinity_norm(bounds.reshape(-1))
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
