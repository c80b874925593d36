# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""This package's controller as a peer: validation, safety ladder and all, as in the node."""

from __future__ import annotations

import dataclasses
from functools import partial

from peers.peer import Effort, PeerKind

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.safety.ladder import Source
from quad_mpc_ros.control.tick import Tick
from quad_mpc_ros.control.warm_up import warmed_up


class ControllerPeer:
    """The whole controller, from the boundary's values in to the command out."""

    def __init__(self, config: MpcConfig) -> None:
        self._controller = warmed_up(config)
        self._tick: Tick | None = None

    def step(self, odometry: OdometrySample, window: ReferenceWindow) -> CommandSample | None:
        """Return the command, whichever level of the failsafe gives it."""
        self._tick = self._controller.step(odometry, window)
        return None if self._tick is None else self._tick.command

    def effort(self) -> Effort:
        """Return OSQP's iterations and run time, summed over the solves of the last step."""
        if self._tick is None:
            return Effort(solved=False, iterations=0, solve_time=0.0)
        return Effort(
            solved=self._tick.decision.source is Source.MPC,
            iterations=self._tick.stats.iterations,
            solve_time=self._tick.stats.solve_time_us * 1e-6,
            mpc_time=self._tick.stats.step_time_us * 1e-6,
        )


CONTROLLER = PeerKind(
    title="this controller",
    solver="OSQP",
    description="`formulation: manifold`, with all checks of the node.",
    make=lambda config, _: partial(ControllerPeer, config),
    swept=True,
)
PAPER = PeerKind(
    title="this controller, the paper's formulation",
    solver="OSQP",
    description="`formulation: paper`, one linearisation for the whole horizon.",
    make=lambda config, _: partial(
        ControllerPeer, dataclasses.replace(config, formulation="paper")
    ),
)
