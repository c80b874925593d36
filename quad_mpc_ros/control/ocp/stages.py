"""The stages of a horizon: the numbers of its QP in physical units, and their sparsity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.configuration.compilation import compiled
from quad_mpc_ros.control.lie import Array

Mask = NDArray[np.bool_]
Shape = NDArray[np.int64]
"""Of stages (5,): how many there are, states, inputs, soft rows and slacks of each."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LimitPattern:
    """Soft inequalities of a stage: nr rows, each eased by one of ns slacks.

    ``mask`` (nr, 2 nu + nx) says which of u_{i-1}, u_i and x_{i+1}, side by side, a row has;
    ``slack_of`` (nr,) by which slack it is eased, ``slack_size`` (ns,) > 0 is a slack's natural
    size, in the unit of its rows. Rows that share a slack share what easing costs: it pays for the
    one that is violated most.
    """

    mask: Mask
    slack_of: NDArray[np.intp]
    slack_size: Array

    @staticmethod
    def none(nx: int, nu: int) -> LimitPattern:
        """Return no rows at all."""
        return LimitPattern(
            mask=np.zeros((0, 2 * nu + nx), dtype=bool),
            slack_of=np.zeros(0, dtype=np.intp),
            slack_size=np.zeros(0),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class HorizonPattern:
    """Which entries of a stage can ever be non-zero, and the natural size of each variable.

    ``A`` (nx, nx), ``B`` (nx, nu) and ``H`` (nx, nx, symmetric) are masks; ``state_size`` (nx,)
    and ``input_size`` (nu,) are positive. Without ``limits`` a stage has no soft rows.
    """

    steps: int
    A: Mask
    B: Mask
    H: Mask
    state_size: Array
    input_size: Array
    limits: LimitPattern | None = None

    @property
    def soft(self) -> LimitPattern:
        """The soft rows of a stage, none of them without ``limits``."""
        if self.limits is not None:
            return self.limits
        return LimitPattern.none(len(self.state_size), len(self.input_size))


class StageParts(NamedTuple):
    """The numbers of a horizon: the parts of one buffer, see :func:`stages_in`.

    ``x0`` (nx,), ``dynamics`` (N, nx, nx+nu+1) with A, B and c side by side, ``state_cost``
    (N, nx, nx+1) with H and g of the states 1 to N, ``input_terms`` (N, 4, nu) with the diagonal
    of R, r, lower and upper one below another, ``limits`` (N, nr, 2 nu + nx + 1) with the normals
    on u_{i-1}, u_i and x_{i+1} and the bound b of the soft rows,
    normal · (u_{i-1}, u_i, x_{i+1}) - slack <= b, and ``slack_cost`` (N, ns, 2) with the linear
    and the quadratic price of each slack s >= 0, c s + 1/2 d s^2. The normal on u_{-1} of the
    first stage is not used.
    """

    x0: Array
    dynamics: Array
    state_cost: Array
    input_terms: Array
    limits: Array
    slack_cost: Array


@compiled
def stages_in(shape: Shape, buffer: Array) -> StageParts:
    """Return the parts of a buffer, in which they are one after another."""
    n, nx, nu, nr, ns = shape[0], shape[1], shape[2], shape[3], shape[4]
    row = 2 * nu + nx + 1
    dynamics = nx
    state_cost = dynamics + n * nx * (nx + nu + 1)
    input_terms = state_cost + n * nx * (nx + 1)
    limits = input_terms + n * 4 * nu
    slack_cost = limits + n * nr * row
    return StageParts(
        buffer[:dynamics],
        buffer[dynamics:state_cost].reshape((n, nx, nx + nu + 1)),
        buffer[state_cost:input_terms].reshape((n, nx, nx + 1)),
        buffer[input_terms:limits].reshape((n, 4, nu)),
        buffer[limits:slack_cost].reshape((n, nr, row)),
        buffer[slack_cost : slack_cost + n * ns * 2].reshape((n, ns, 2)),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class HorizonStages:
    """The numbers of one horizon in physical units, to be written in place.

    Compiled code takes ``shape`` and ``buffer``, and gives the numbers their names by
    :func:`stages_in`; Python has them as properties.
    """

    shape: Shape
    buffer: Array

    @staticmethod
    def zeros(steps: int, nx: int, nu: int, *, rows: int = 0, slacks: int = 0) -> HorizonStages:
        """Return room for a horizon, with so many soft rows and slacks a stage."""
        in_stage = nx * (nx + nu + 1) + nx * (nx + 1) + 4 * nu
        soft = rows * (2 * nu + nx + 1) + 2 * slacks
        return HorizonStages(
            shape=np.array([steps, nx, nu, rows, slacks]),
            buffer=np.zeros(nx + steps * (in_stage + soft)),
        )

    @property
    def parts(self) -> StageParts:
        """The parts of the buffer."""
        return stages_in(self.shape, self.buffer)

    @property
    def x0(self) -> Array:
        """(nx,), in place, as are all that follow."""
        return self.parts.x0

    @property
    def A(self) -> Array:
        """(N, nx, nx)."""
        return self.parts.dynamics[:, :, : self.shape[1]]

    @property
    def B(self) -> Array:
        """(N, nx, nu)."""
        return self.parts.dynamics[:, :, self.shape[1] : -1]

    @property
    def c(self) -> Array:
        """(N, nx)."""
        return self.parts.dynamics[:, :, -1]

    @property
    def H(self) -> Array:
        """(N, nx, nx), symmetric."""
        return self.parts.state_cost[:, :, :-1]

    @property
    def g(self) -> Array:
        """(N, nx)."""
        return self.parts.state_cost[:, :, -1]

    @property
    def R(self) -> Array:
        """(N, nu), the diagonal."""
        return self.parts.input_terms[:, 0]

    @property
    def r(self) -> Array:
        """(N, nu)."""
        return self.parts.input_terms[:, 1]

    @property
    def lower(self) -> Array:
        """(N, nu)."""
        return self.parts.input_terms[:, 2]

    @property
    def upper(self) -> Array:
        """(N, nu)."""
        return self.parts.input_terms[:, 3]

    @property
    def normals(self) -> Array:
        """(N, nr, 2 nu + nx), of the soft rows on u_{i-1}, u_i and x_{i+1}."""
        return self.parts.limits[:, :, :-1]

    @property
    def offsets(self) -> Array:
        """(N, nr), the bounds of the soft rows."""
        return self.parts.limits[:, :, -1]

    @property
    def slack_cost(self) -> Array:
        """(N, ns, 2), linear and quadratic price of each slack."""
        return self.parts.slack_cost
