# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Check a reference against the limits of a vehicle, before a flight.

The angular frequency of a lemniscate is increased until the check rejects the lemniscate;
``time_scaling="auto"`` slows the lemniscate down instead.
"""

import dataclasses

from quad_mpc_ros import ReferenceConfig
from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.references.configured import configured_trajectory, judged_trajectory

highest = {}
for frequency in (1.0, 2.0, 3.0):
    config = ReferenceConfig(trajectory="lemniscate", angular_frequency=frequency)
    _, verdict = judged_trajectory(config)
    speed = verdict.over_time.speed.max()
    highest[frequency] = verdict.over_time.throttle.max()
    answer = "yes" if verdict.feasible else f"no: {verdict.reason()}"
    print(f"{frequency:.0f} rad/s, {speed:4.1f} m/s, throttle {highest[frequency]:.2f}: {answer}")

too_fast = ReferenceConfig(trajectory="lemniscate", angular_frequency=6.0)
try:
    configured_trajectory(too_fast)
except ConfigurationError as error:
    refusal = str(error)
    print(f"refused: {refusal}")

slowed = configured_trajectory(dataclasses.replace(too_fast, time_scaling="auto"))
seconds = 1e-9 * slowed.period_ns
print(f"slowed down until it can: once round in {seconds:.2f} s")
