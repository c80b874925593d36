"""What is compared: what a peer can do, how one is defined, and how a file defines another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:  # --help imports this and must be quick
    from quad_mpc_ros.control.config import MpcConfig
    from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow


@dataclass(frozen=True, kw_only=True)
class Effort:
    """Effort of the last step of a peer.

    ``solve_time`` [s] is as the solver reports it; ``mpc_time`` [s] is the time of the MPC alone
    where a step does more.
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


NewPeer = Callable[[], Peer]
"""Makes a peer for one flight."""


class PeerUnavailableError(Exception):
    """A peer cannot fly here; the message says why and what to install."""


@dataclass(frozen=True, kw_only=True)
class PeerKind:
    """A peer as it is defined: what it is called, and how it is made.

    ``make`` takes the configuration and a folder for what has to be compiled, once for each
    length of the horizon; it raises :class:`PeerUnavailableError` where the peer cannot fly.
    """

    title: str
    solver: str
    """Whose own time is reported beside the whole step."""
    description: str
    """A paragraph for the page, in Markdown."""
    make: Callable[[MpcConfig, Path], NewPeer]
    swept: bool = False
    """Whether its cost against the length of the horizon is measured, too."""
    distributions: tuple[str, ...] = ()
    """The installed packages whose versions the page lists."""
