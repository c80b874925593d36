# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Steps of the odometry in hover: what they do with the estimator on and off.

python -P bench/estimate_steps.py                   # the table of docs/measurements/robustness.md
python -P bench/estimate_steps.py --only heading    # rows whose name has the word

The odometry of a vehicle that hovers is off by a step for one sample or for four seconds, in calm
air or in a wind of 2 m/s. For each row and column the largest distance [cm] of the vehicle from
where it was at the step, with ``estimate_disturbance`` on / off.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import fly
from quad_mpc_ros.simulation.config import SimulatorConfig

BEGINS, ENDS = 4.0, 12.0  # s, of the step and of the flight
HEIGHT = 5.0  # m
_SECOND = 1_000_000_000


class Step(NamedTuple):
    """Error of the odometry.

    Attributes:
        name: The row of the table.
        move_W: Of the position [m].
        turn: Rotation vector of the attitude in the world [rad].
        velocity_W: Of the velocity [m/s].
        announced: Whether it is published on ``odom_reset``.
        twist_in_world: Whether the velocity is estimated in the world, so that the twist in the
            body turns with the attitude. An announced step turns the world.
    """

    name: str
    move_W: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    velocity_W: tuple[float, float, float] = (0.0, 0.0, 0.0)
    announced: bool = False
    twist_in_world: bool = False

    def of(self, odometry: OdometrySample) -> OdometrySample:
        """Return the odometry with its error."""
        if self.announced:
            return self.reset(odometry.stamp_ns, back=False).odometry(odometry)
        R_WB = so3.rotation_from_quaternion_xyzw(odometry.q_WB_xyzw)
        R_off, v_WB_B = so3.exp(self.turn) @ R_WB, odometry.v_WB_B + R_WB.T @ self.velocity_W
        return dataclasses.replace(
            odometry,
            p_WB=odometry.p_WB + self.move_W,
            q_WB_xyzw=so3.quaternion_xyzw_from_rotation(R_off),
            v_WB_B=R_off.T @ R_WB @ v_WB_B if self.twist_in_world else v_WB_B,
        )

    def reset(self, stamp_ns: int, *, back: bool) -> EstimateReset:
        """Return the announcement of the step, or of the step back."""
        sign = -1.0 if back else 1.0
        move_W = sign * np.array(self.move_W)
        return EstimateReset(stamp_ns=stamp_ns, turn=sign * self.turn[2], step_W=move_W)


def steps() -> Iterator[Step]:
    """Yield the rows of the table."""
    for announced in (False, True):
        note = ", announced" if announced else ""
        for size in (0.5, 2.0, 30.0):
            yield Step(f"position {size} m{note}", move_W=(size, 0.0, 0.0), announced=announced)
        for size in (0.5, 2.0):
            yield Step(f"height {size} m{note}", move_W=(0.0, 0.0, size), announced=announced)
        for degrees in (10, 30, 50, 90, 180):
            turn = (0.0, 0.0, math.radians(degrees))
            name = f"heading {degrees}°{note}"
            yield Step(name, turn=turn, announced=announced, twist_in_world=True)
    for degrees in (5, 10, 20, 60):
        turn = (math.radians(degrees), 0.0, 0.0)
        yield Step(f"roll {degrees}°", turn=turn, twist_in_world=True)
    for speed in (0.5, 2.0, 3.0, 10.0):
        yield Step(f"velocity {speed} m/s", velocity_W=(speed, 0.0, 0.0))


class Stepping:
    """A controller whose odometry is off by a step for a time."""

    def __init__(self, step: Step, *, lasts: float, learns: bool) -> None:
        mpc = MpcConfig(estimate_disturbance=learns)
        self.controller: Controller = warmed_up(mpc)
        self._step, self._lasts = step, lasts
        self._begin_ns: int | None = None
        self._is_off = False

    def __call__(self, odometry: OdometrySample, window: ReferenceWindow) -> CommandSample | None:
        """Return the command for the odometry with its error."""
        if self._begin_ns is None:
            self._begin_ns = odometry.stamp_ns
        since = (odometry.stamp_ns - self._begin_ns) / _SECOND - BEGINS
        was_off, self._is_off = self._is_off, 0.0 <= since < self._lasts
        if self._step.announced and self._is_off != was_off:
            self.controller.reset_estimate(self._step.reset(odometry.stamp_ns, back=was_off))
        if self._step.announced and self._is_off:  # the reference holds, and moves along
            window = self._step.reset(odometry.stamp_ns, back=False).window(window)
        tick = self.controller.step(self._step.of(odometry) if self._is_off else odometry, window)
        return None if tick is None else tick.command


def moved(step: Step, *, lasts: float, wind: float, learns: bool) -> float:
    """Return the distance that a hovering vehicle moves [m]."""
    simulator = SimulatorConfig(
        initial_position=(0.0, 0.0, HEIGHT),
        initial_throttle=0.3,
        duration=ENDS,
        wind=(wind, 0.0, 0.0),
    )
    reference = ReferenceConfig(trajectory="hover", height=HEIGHT)
    flown = fly(
        simulator=simulator,
        reference=reference,
        controller=Stepping(step, lasts=lasts, learns=learns),
    )
    p_WB = np.array([each.truth.p_WB for each in flown])
    after = p_WB[round(BEGINS * simulator.odom_rate) :]
    return float(np.linalg.norm(after - after[0], axis=1).max())


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly, and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--only", default="", metavar="TEXT", help="rows whose name has it")
    options = parser.parse_args(arguments)
    print("| step | one sample, calm | wind | 4 s, calm | wind |\n|---|---|---|---|---|")
    for step in steps():
        if options.only not in step.name:
            continue
        cells = [
            " / ".join(
                f"{100.0 * moved(step, lasts=lasts, wind=wind, learns=learns):.1f}"
                for learns in (True, False)
            )
            for lasts in (0.02, 4.0)
            for wind in (0.0, 2.0)
        ]
        print(f"| {step.name} | {' | '.join(cells)} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
