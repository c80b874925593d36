"""The peers by name, as options, tables and pictures call them."""

from __future__ import annotations

from dataclasses import dataclass


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
