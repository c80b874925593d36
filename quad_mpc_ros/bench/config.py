"""What a comparison is to fly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from quad_mpc_ros.bench.peers import SWEPT
from quad_mpc_ros.mpc_config import MpcConfig
from quad_mpc_ros.simulation.config import SimulatorConfig
from quad_mpc_ros.trajectories.config import ReferenceConfig


@dataclass(frozen=True, kw_only=True)
class BenchConfig:
    """The peers at ``mpc.horizon_steps``, and some of them at each of ``steps``, in turns."""

    mpc: MpcConfig
    simulator: SimulatorConfig
    reference: ReferenceConfig
    peers: Sequence[str]
    steps: Sequence[int]
    repeats: int

    def entries(self) -> list[Entry]:
        """Return everything that is to fly, each once."""
        compared = [Entry(peer, self.mpc.horizon_steps) for peer in self.peers]
        swept = [
            Entry(peer, steps) for steps in self.steps for peer in SWEPT if peer in self.peers
        ]
        return list(dict.fromkeys(compared + swept))


@dataclass(frozen=True)
class Entry:
    """One line of the result: a peer with a horizon of ``steps``."""

    peer: str
    steps: int
