"""How each peer is made."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

from quad_mpc_ros.bench.acados_peer import AcadosPeer
from quad_mpc_ros.bench.acados_solver import build_solver
from quad_mpc_ros.bench.controller_peer import ControllerPeer
from quad_mpc_ros.bench.cvxpy_peer import CvxpyPeer, cvxpy_module
from quad_mpc_ros.bench.peer import Peer
from quad_mpc_ros.mpc_config import MpcConfig

NewPeer = Callable[[], Peer]
"""Makes a peer for one flight."""


def prepare(peer: str, config: MpcConfig, folder: Path) -> NewPeer:
    """Return how to make a peer by name; ``folder`` is for what has to be compiled once.

    Raises :class:`~quad_mpc_ros.bench.peer.PeerUnavailableError` when it cannot fly here.
    """
    return _PREPARATIONS[peer](config, folder)


def _controller(config: MpcConfig, _: Path) -> NewPeer:
    return lambda: ControllerPeer(config)


def _paper(config: MpcConfig, _: Path) -> NewPeer:
    return lambda: ControllerPeer(dataclasses.replace(config, formulation="paper"))


def _acados(config: MpcConfig, folder: Path) -> NewPeer:
    solver = build_solver(config, folder)
    return lambda: AcadosPeer(config, solver)


def _cvxpy(config: MpcConfig, _: Path) -> NewPeer:
    cvxpy = cvxpy_module()
    return lambda: CvxpyPeer(config, cvxpy)


_PREPARATIONS: dict[str, Callable[[MpcConfig, Path], NewPeer]] = {
    "controller": _controller,
    "paper": _paper,
    "acados": _acados,
    "cvxpy": _cvxpy,
}
