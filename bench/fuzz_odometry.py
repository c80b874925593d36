# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Odometry with one wrong field in one message of ten: rejected messages and largest errors.

    python -P bench/fuzz_odometry.py                 # 10,000 wrong messages
    python -P bench/fuzz_odometry.py --count 500

Vehicles hover in gusts with noise. For each kind of fault a line: wrong messages, the share that
is rejected, the farthest that a vehicle is from its reference [cm], and how many flights fail: an
exception, more than half a metre, or a last command that is not of the MPC. Faults that are not
rejected are smaller than what counts as a jump.
"""

from __future__ import annotations

import argparse
import dataclasses
import random
import sys
from collections import defaultdict
from collections.abc import Callable, Sequence

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.tick import Tick
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import fly
from quad_mpc_ros.simulation.config import SimulatorConfig

DURATION, SETTLED, EVERY, FARTHEST = 14.0, 2.0, 10, 0.5  # s, s, odometries, m
PER_FLIGHT = int((DURATION - SETTLED) * 50 / EVERY)
VECTORS = ("p_WB", "v_WB_B", "w_WB_B", "q_WB_xyzw")
Fault = Callable[[OdometrySample, random.Random], OdometrySample]


def scaled(*factors: float) -> Fault:
    """Return the fault that one vector or one of its components is so many times too large."""

    def fault(odometry: OdometrySample, draw: random.Random) -> OdometrySample:
        name, factor = draw.choice(VECTORS), draw.choice(factors)
        values = getattr(odometry, name).copy()
        if draw.random() < 0.5:
            values *= factor
        else:
            values[draw.randrange(len(values))] *= factor
        return dataclasses.replace(odometry, **{name: values})

    return fault


def permuted(odometry: OdometrySample, draw: random.Random) -> OdometrySample:
    """Order the components of a vector in another way, as with wxyz in place of xyzw."""
    name = draw.choice(VECTORS)
    values = getattr(odometry, name)
    order = draw.sample(range(len(values)), len(values))
    return dataclasses.replace(odometry, **{name: values[order]})


def stamped(odometry: OdometrySample, draw: random.Random) -> OdometrySample:
    """Change the stamp."""
    off_ns = draw.choice((-(10**9), -(10**7), 3 * 10**7, 10**9, 3600 * 10**9))
    other = draw.choice((0, 1, odometry.stamp_ns // 1000, odometry.stamp_ns + off_ns))
    return dataclasses.replace(odometry, stamp_ns=other)


def framed(odometry: OdometrySample, draw: random.Random) -> OdometrySample:
    """Change the frame, or convert to NED."""
    frame = draw.choice(("map", "", "odom_ned", "base_link"))
    if draw.random() < 0.5:
        return dataclasses.replace(odometry, frame_id=frame)
    return dataclasses.replace(odometry, p_WB=odometry.p_WB[[1, 0, 2]] * (1.0, 1.0, -1.0))


FAULTS: dict[str, Fault] = {
    "frame": framed,
    "sign": scaled(-1.0),
    "unit": scaled(100.0, 57.3, 3.28, 0.01, 0.0175),
    "not finite": scaled(float("nan"), float("inf"), 1e300),
    "zero": scaled(0.0),
    "order of components": permuted,
    "stamp": stamped,
}


class Faulty:
    """A controller of which one odometry in ten is wrong, repeated, or missing."""

    def __init__(self, kind: str, seed: int) -> None:
        self.controller: Controller = warmed_up(MpcConfig())
        self.tick: Tick | None = None
        self._kind, self._draw, self._count = kind, random.Random(seed), 0
        self._before: list[OdometrySample] = []

    def __call__(self, odometry: OdometrySample, window: ReferenceWindow) -> CommandSample | None:
        """Return the command in answer to an odometry."""
        self._count += 1
        now_ns, given = odometry.stamp_ns, odometry
        if self._count > SETTLED * 50 and self._count % EVERY == 0:
            if self._kind == "repeated or late":
                given = self._draw.choice(self._before[-20:])
            elif self._kind == "missing":
                return None
            else:
                given = FAULTS[self._kind](odometry, self._draw)
        self._before.append(odometry)
        self.controller.receive_reference(window, now_ns=now_ns)
        tick = self.controller.receive_odometry(given, now_ns=now_ns)
        tick = tick or self.controller.watch(now_ns=now_ns)
        self.tick = tick or self.tick
        return None if tick is None else tick.command


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly, and print the table; the exit code is 1 if a flight failed."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--count", type=int, default=10_000, help="wrong messages in all")
    count = parser.parse_args(arguments).count
    kinds = [*FAULTS, "repeated or late", "missing"]
    flights: dict[str, int] = defaultdict(int)
    for number in range(-(-count // PER_FLIGHT)):
        flights[kinds[number % len(kinds)]] += 1
    failures = 0
    for kind, number in flights.items():
        rejected, farthest, failed = 0, 0.0, 0
        for seed in range(number):
            law, moved, fault = Faulty(kind, seed), np.inf, ""
            simulator = SimulatorConfig(
                initial_position=(0.0, 0.0, 5.0),
                initial_throttle=0.3,
                duration=DURATION,
                odom_rate=50.0,
                position_noise=0.005,
                velocity_noise=0.02,
                gust_intensity=0.5,
                seed=seed,
            )
            hover = ReferenceConfig(trajectory="hover", height=5.0)
            try:
                flown = [*fly(simulator=simulator, reference=hover, controller=law)]
                moved = max(np.linalg.norm(each.truth.p_WB - (0.0, 0.0, 5.0)) for each in flown)
            except Exception as error:
                fault = repr(error)
            if not fault and (law.tick is None or law.tick.decision.source.name != "MPC"):
                fault = "nothing commands" if law.tick is None else str(law.tick.decision)
            if fault or moved > FARTHEST:
                failed += 1
                print(f"{kind}, seed {seed}: {fault or f'{moved:.2f} m'}", file=sys.stderr)
            rejected += 0 if law.tick is None else law.tick.stats.rejected_inputs
            farthest = max(farthest, moved)
        share = rejected / (number * PER_FLIGHT)
        print(f"{kind:20} {number * PER_FLIGHT:6} {share:7.1%} {100 * farthest:7.1f} {failed:4}")
        failures += failed
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
