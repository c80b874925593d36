"""The stages of a horizon: the numbers of its QP in physical units, and their sparsity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.lie import Array

Mask = NDArray[np.bool_]


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


@dataclass(frozen=True, kw_only=True, eq=False)
class HorizonStages:
    """The numbers of one horizon in physical units, to be written in place.

    They are kept in a few blocks, for compiled code: ``x0`` (nx,), ``dynamics`` (N, nx, nx+nu+1)
    with A, B and c side by side, ``state_cost`` (N, nx, nx+1) with H and g of the states 1 to N,
    ``input_terms`` (N, 4, nu) with the diagonal of R, r, lower and upper one below another,
    ``limits`` (N, nr, 2 nu + nx + 1) with the normals on u_{i-1}, u_i and x_{i+1} and the bound b
    of the soft rows, normal · (u_{i-1}, u_i, x_{i+1}) - slack <= b, and ``slack_cost`` (N, ns, 2)
    with the linear and the quadratic price of each slack s >= 0, c s + 1/2 d s^2. The normal on
    u_{-1} of the first stage is not used.
    """

    x0: Array
    dynamics: Array
    state_cost: Array
    input_terms: Array
    limits: Array
    slack_cost: Array

    @staticmethod
    def zeros(steps: int, nx: int, nu: int, *, rows: int = 0, slacks: int = 0) -> HorizonStages:
        """Return room for a horizon, with so many soft rows and slacks a stage."""
        return HorizonStages(
            x0=np.zeros(nx),
            dynamics=np.zeros((steps, nx, nx + nu + 1)),
            state_cost=np.zeros((steps, nx, nx + 1)),
            input_terms=np.zeros((steps, 4, nu)),
            limits=np.zeros((steps, rows, 2 * nu + nx + 1)),
            slack_cost=np.zeros((steps, slacks, 2)),
        )

    @property
    def shape(self) -> tuple[int, int, int]:
        """The number of steps, of states and of inputs."""
        return len(self.dynamics), len(self.x0), self.input_terms.shape[2]

    @property
    def soft_shape(self) -> tuple[int, int]:
        """The number of soft rows and of slacks of a stage."""
        return self.limits.shape[1], self.slack_cost.shape[1]

    @property
    def A(self) -> Array:
        """(N, nx, nx), in place, as are all that follow."""
        return self.dynamics[:, :, : len(self.x0)]

    @property
    def B(self) -> Array:
        """(N, nx, nu)."""
        return self.dynamics[:, :, len(self.x0) : -1]

    @property
    def c(self) -> Array:
        """(N, nx)."""
        return self.dynamics[:, :, -1]

    @property
    def H(self) -> Array:
        """(N, nx, nx), symmetric."""
        return self.state_cost[:, :, :-1]

    @property
    def g(self) -> Array:
        """(N, nx)."""
        return self.state_cost[:, :, -1]

    @property
    def R(self) -> Array:
        """(N, nu), the diagonal."""
        return self.input_terms[:, 0]

    @property
    def r(self) -> Array:
        """(N, nu)."""
        return self.input_terms[:, 1]

    @property
    def lower(self) -> Array:
        """(N, nu)."""
        return self.input_terms[:, 2]

    @property
    def upper(self) -> Array:
        """(N, nu)."""
        return self.input_terms[:, 3]

    @property
    def normals(self) -> Array:
        """(N, nr, 2 nu + nx), of the soft rows on u_{i-1}, u_i and x_{i+1}."""
        return self.limits[:, :, :-1]

    @property
    def offsets(self) -> Array:
        """(N, nr), the bounds of the soft rows."""
        return self.limits[:, :, -1]
