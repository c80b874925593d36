"""What is compared: the peers by name, and what each of them can do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:  # the names are wanted for --help, which shall be quick
    from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow


@dataclass(frozen=True, kw_only=True)
class PeerKind:
    """A peer's title, and whose own time is told beside its whole step."""

    title: str
    solver: str


PEERS = {
    "controller": PeerKind(title="this controller", solver="OSQP"),
    "acados": PeerKind(title="acados SQP_RTI + HPIPM", solver="its C code"),
    "paper": PeerKind(title="this controller, the paper's formulation", solver="OSQP"),
    "cvxpy": PeerKind(title="the same QP through cvxpy, rebuilt each step", solver="OSQP"),
}

SWEPT = ("controller", "acados")
"""Those whose cost against the length of the horizon is measured."""


@dataclass(frozen=True, kw_only=True)
class Effort:
    """What the last step of a peer took.

    ``solve_time`` [s] is what its solver says of itself. ``mpc_time`` [s] is that of the MPC
    alone, where there is more to a step.
    """

    solved: bool
    iterations: int
    solve_time: float
    mpc_time: float | None = None


class Peer(Protocol):
    """One controller under comparison. The time of :meth:`step` is what is measured."""

    def step(self, odometry: OdometrySample, window: ReferenceWindow) -> CommandSample | None:
        """Return the command that answers an odometry, or None when there is none."""
        ...

    def effort(self) -> Effort:
        """Return what the last step took of the solver; asked for outside the measured time."""
        ...


class PeerUnavailableError(Exception):
    """A peer cannot fly here; the message says why and what to install."""
