"""This package's controller as a peer: validation, safety ladder and all, as in the node."""

from __future__ import annotations

import dataclasses
from functools import partial
from pathlib import Path

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.safety.ladder import Source
from quad_mpc_ros.control.tick import Tick
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.experiments.bench.peers import Effort, NewPeer, PeerKind


class ControllerPeer:
    """The whole controller, from the boundary's values in to the command out."""

    def __init__(self, config: MpcConfig) -> None:
        self._controller = warmed_up(config)
        self._tick: Tick | None = None

    def step(self, odometry: OdometrySample, window: ReferenceWindow) -> CommandSample | None:
        """Return the command, whichever rung of the safety ladder gives it."""
        now_ns = odometry.stamp_ns
        self._controller.receive_reference(window, now_ns=now_ns)
        self._tick = self._controller.receive_odometry(odometry, now_ns=now_ns)
        return None if self._tick is None else self._tick.command

    def effort(self) -> Effort:
        """Return OSQP's iterations and run time, summed over the solves of the last step.

        The MPC alone predicts, linearises, updates, solves and applies.
        """
        if self._tick is None:
            return Effort(solved=False, iterations=0, solve_time=0.0)
        return Effort(
            solved=self._tick.decision.source is Source.MPC,
            iterations=self._tick.stats.iterations,
            solve_time=self._tick.stats.solve_time_us * 1e-6,
            mpc_time=self._tick.stats.step_time_us * 1e-6,
        )


def _controller(config: MpcConfig, _: Path) -> NewPeer:
    return partial(ControllerPeer, config)


CONTROLLERS = {
    "controller": PeerKind(
        title="this controller",
        solver="OSQP",
        description="`formulation: manifold` with all that the node does: validation, safety "
        "ladder, statistics.",
        make=_controller,
        swept=True,
    ),
    "paper": PeerKind(
        title="this controller, the paper's formulation",
        solver="OSQP",
        description="this controller with `formulation: paper`, one linearisation held over the "
        "horizon.",
        make=lambda config, folder: _controller(
            dataclasses.replace(config, formulation="paper"), folder
        ),
    ),
}
"""This package's own peers, by name."""
