"""The stages of a horizon: the numbers of its QP in physical units, and their sparsity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.lie import Array

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

    They are kept in a few blocks, for compiled code: ``x0`` (nx,), ``dynamics`` (N, nx, nx+nu+1)
    with A, B and c side by side, ``state_cost`` (N, nx, nx+1) with H and g of the states 1 to N,
    ``input_terms`` (N, 4, nu) with the diagonal of R, r, lower and upper one below another.
    """

    x0: Array
    dynamics: Array
    state_cost: Array
    input_terms: Array

    @staticmethod
    def zeros(steps: int, nx: int, nu: int) -> HorizonStages:
        """Return room for a horizon."""
        return HorizonStages(
            x0=np.zeros(nx),
            dynamics=np.zeros((steps, nx, nx + nu + 1)),
            state_cost=np.zeros((steps, nx, nx + 1)),
            input_terms=np.zeros((steps, 4, nu)),
        )

    @property
    def shape(self) -> tuple[int, int, int]:
        """The number of steps, of states and of inputs."""
        return len(self.dynamics), len(self.x0), self.input_terms.shape[2]

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
