# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Run the example of RAPTOR's package ``foundation-policy`` in l2f, without this package.

    python -P bench/raptor_example.py --starts 64

The policy flies l2f's vehicle from states that l2f draws, for 5 s at 100 Hz as in the example.
The policy loads only if it reproduces its recorded outputs. A start fails if the mean distance
from the origin is above 0.5 m in the last second. Prints the percentiles of this distance.
docs/measurements/controllers.md.
"""

from __future__ import annotations

import argparse
import importlib
from typing import Any

import numpy as np

STEPS, LAST, FAR = 500, 100, 0.5


def flown(l2f: Any, policy: Any, seed: int) -> float:
    """Fly from one start; return the mean distance from the origin in the last second [m]."""
    device, env, rng = l2f.Device(), l2f.Environment(), l2f.Rng()
    parameters, now, after = l2f.Parameters(), l2f.State(), l2f.State()
    observed = l2f.Observation()
    l2f.initialize_environment(device, env)
    l2f.initialize_rng(device, rng, seed)
    l2f.sample_initial_parameters(device, env, parameters, rng)
    l2f.sample_initial_state(device, env, parameters, now, rng)
    policy.reset()
    distances = []
    for _ in range(STEPS):
        l2f.observe(device, env, parameters, now, observed, rng)
        observation = np.array(observed.observation)[None, :22]
        action = policy.evaluate_step(observation)[0]
        l2f.step(device, env, parameters, now, action, after, rng)
        now, after = after, now
        distances.append(np.linalg.norm(now.position))
    return float(np.mean(distances[-LAST:]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--starts", type=int, default=64)
    options = parser.parse_args()
    l2f, policy = importlib.import_module("l2f"), importlib.import_module("foundation_policy")
    raptor = policy.Raptor()
    means = [flown(l2f, raptor, seed) for seed in range(options.starts)]
    p50, p95 = 100.0 * np.percentile(means, [50, 95])
    failed = sum(not mean <= FAR for mean in means)
    print(f"{failed} of {len(means)} starts failed; p50 {p50:.1f} cm, p95 {p95:.1f} cm")


if __name__ == "__main__":
    main()
