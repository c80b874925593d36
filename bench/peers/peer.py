# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A peer: a controller that ``bench/performance.py`` compares with this package's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

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
    """One controller under comparison. The time of :meth:`step` is measured."""

    def step(self, odometry: OdometrySample, window: ReferenceWindow) -> CommandSample | None:
        """Return the command that answers an odometry, or None when there is none."""
        ...

    def effort(self) -> Effort:
        """Return the effort of the last step; called outside of the measured time."""
        ...


NewPeer = Callable[[], Peer]
"""Makes a peer for one flight."""


SOFT_LIMITS = ("tilt_max", "speed_max")


def soft_limits_of(config: MpcConfig) -> list[str]:
    """Return the names of the soft limits of the plan that are active."""
    return [name for name in SOFT_LIMITS if getattr(config.limits, name) > 0.0]


class PeerUnavailableError(Exception):
    """A peer cannot fly here; the message gives the reason and what to install."""


@dataclass(frozen=True, kw_only=True)
class PeerKind:
    """A peer of the comparison.

    ``solver`` names the solver whose own time is reported next to the whole step, ``description``
    is a paragraph of the page in Markdown. ``make`` takes the configuration and a folder for
    compiled code and raises :class:`PeerUnavailableError` where the peer cannot fly. A ``swept``
    peer is measured with other lengths of the horizon as well. ``package`` is a distribution whose
    version the page lists.
    """

    title: str
    solver: str
    description: str
    make: Callable[[MpcConfig, Path], NewPeer]
    swept: bool = False
    package: str | None = None
