"""The stages of a horizon: the numbers of its QP in physical units, and their sparsity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quad_mpc_ros.control.lie import Array

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


class HorizonStages(NamedTuple):
    """The numbers of one horizon in physical units, to be written in place.

    ``x0`` (nx,) is the state at its start. Of the stages 0 to N - 1 there are the dynamics
    ``A`` (N, nx, nx), ``B`` (N, nx, nu), ``c`` (N, nx); of the states 1 to N the cost ``H``
    (N, nx, nx, symmetric) and ``g`` (N, nx); of the inputs the diagonal of ``R``, ``r`` and the
    bounds ``lower``, ``upper`` (N, nu); and of the soft rows, normal · (u_{i-1}, u_i, x_{i+1}) -
    slack <= offset, the ``normals`` (N, nr, 2 nu + nx), ``offsets`` (N, nr) and the price of each
    slack s >= 0, ``linear`` s + 1/2 ``quadratic`` s^2 (N, ns). The normal on u_{-1} of the first
    stage is not used.
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
    normals: Array
    offsets: Array
    linear: Array
    quadratic: Array

    @staticmethod
    def zeros(steps: int, nx: int, nu: int, *, rows: int = 0, slacks: int = 0) -> HorizonStages:
        """Return room for a horizon, with so many soft rows and slacks a stage."""
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
            normals=np.zeros((steps, rows, 2 * nu + nx)),
            offsets=np.zeros((steps, rows)),
            linear=np.zeros((steps, slacks)),
            quadratic=np.zeros((steps, slacks)),
        )

    @property
    def sizes(self) -> tuple[int, int, int, int, int]:
        """How many stages there are; states, inputs, soft rows and slacks of each."""
        return (*self.B.shape, self.offsets.shape[1], self.linear.shape[1])
