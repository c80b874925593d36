"""What is compared: anything that turns an odometry and a reference into a command."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from quad_mpc_ros.model.samples import CommandSample, OdometrySample, ReferenceWindow


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
