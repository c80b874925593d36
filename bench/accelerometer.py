# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Hover and lemniscate by odometry with a noisy velocity, without an accelerometer and with one.

python -P bench/accelerometer.py --plant rotors --seeds 4

For each flight a line: RMSE and largest error from 5 s on by the true state [mm], means over the
seeds, without the accelerometer and with ``accelerometer_noise``. Velocity noise of 0.3 m/s, white
or correlated over 1 s; gusts of 1 m/s in wind, or calm air. docs/explanation/estimation.md.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.simulation.closed_loop import fly
from quad_mpc_ros.simulation.config import SimulatorConfig

_DURATION, _SETTLED_NS = 20.0, 5_000_000_000
_HEIGHT = 2.0
_NOISES: Mapping[str, Mapping[str, float]] = {
    "white": {"velocity_noise": 0.3},
    "correlated": {"velocity_noise": 0.02, "velocity_drift": 0.3},
}
_AIR: Mapping[str, Mapping[str, Any]] = {
    "gusts": {"gust_intensity": 1.0, "wind": (2.0, -1.0, 0.0), "drag": 0.4},
    "calm": {},
}
_TRAJECTORIES = ("hover", "lemniscate")


def simulator(plant: str, noise: str, air: str, *, seed: int, with_imu: bool) -> SimulatorConfig:
    """Return a simulator whose odometry is good but for its velocity."""
    own: dict[str, Any] = {}
    if plant == "internal":  # with the lags that the default expects
        guessed = MpcConfig()
        own["rate_time_constant"] = guessed.rate_time_constant
        own["thrust_time_constant"] = guessed.thrust_time_constant
    if with_imu:
        own.update(imu_rate=200.0, imu_noise=0.2)
    return SimulatorConfig(
        plant=plant,
        seed=seed,
        duration=_DURATION,
        initial_position=(0.0, 0.0, _HEIGHT),
        position_noise=0.003,
        attitude_noise=0.003,
        rate_noise=0.02,
        **{**own, **_NOISES[noise], **_AIR[air]},
    )


def errors(trajectory: str, config: SimulatorConfig, accelerometer_noise: float) -> Array:
    """Return the settled errors (n,) [m] of a flight."""
    reference = ReferenceConfig(trajectory=trajectory, height=_HEIGHT, angular_frequency=1.2)
    mpc = MpcConfig(accelerometer_noise=accelerometer_noise)
    steps = fly(mpc=mpc, simulator=config, reference=reference, on_reference=True)
    flown = [(step.truth, step.window.p_WB[0]) for step in steps]
    begun_ns = flown[0][0].stamp_ns
    apart = [
        float(np.linalg.norm(truth.p_WB - wanted))
        for truth, wanted in flown
        if truth.stamp_ns - begun_ns > _SETTLED_NS
    ]
    return np.array(apart)


def figures(
    trajectory: str, plant: str, noise: str, air: str, *, seeds: int, accelerometer_noise: float
) -> tuple[float, float]:
    """Return RMSE and largest error [mm], means over the seeds."""
    with_imu = accelerometer_noise > 0.0
    found = [
        errors(
            trajectory,
            simulator(plant, noise, air, seed=seed, with_imu=with_imu),
            accelerometer_noise,
        )
        for seed in range(seeds)
    ]
    rmse = np.mean([np.sqrt(np.mean(each**2)) for each in found])
    largest = np.mean([each.max() for each in found])
    return 1e3 * float(rmse), 1e3 * float(largest)


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--plant", action="append", choices=("internal", "rotors"))
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--accelerometer-noise", type=float, default=0.5)
    options = parser.parse_args(arguments)
    plants = options.plant or ("internal", "rotors")
    for plant, noise, air, trajectory in product(plants, _NOISES, _AIR, _TRAJECTORIES):
        without, using = (
            figures(trajectory, plant, noise, air, seeds=options.seeds, accelerometer_noise=value)
            for value in (0.0, options.accelerometer_noise)
        )
        flight = f"{plant:9} {noise:11} {air:6} {trajectory:11}"
        shown = [f"{rmse:6.1f}, {largest:4.0f}" for rmse, largest in (without, using)]
        print(flight, " -> ".join(shown), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
