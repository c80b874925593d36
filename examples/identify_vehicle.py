# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Identify a vehicle from a recorded flight: python examples/identify_vehicle.py [BAG]

Without a bag, a flight is simulated with lags and a delay that are not configured.
"""

import dataclasses
import sys
import tempfile
from pathlib import Path

from quad_mpc_ros import MpcConfig, Recording, identify
from quad_mpc_ros.cli import main

if len(sys.argv) > 1:
    bag = Path(sys.argv[1])
else:
    bag = Path(tempfile.mkdtemp()) / "run"
    plant = ["rate_time_constant=0.04", "thrust_time_constant=0.03", "command_delay=0.02"]
    sets = [word for each in plant for word in ("--set", f"simulator.{each}")]
    main(["simulate", "--reference", "lemniscate", *sets, "--out", str(bag)])

found = identify(Recording(bag))
for name in ("rate_time_constant", "thrust_time_constant", "input_delay", "thrust_scale", "drag"):
    estimates = getattr(found, name)
    for estimate in estimates if isinstance(estimates, tuple) else (estimates,):
        note = "" if estimate.observable else "  not observable"
        print(f"{name:22}{estimate.value:8.4f} +- {estimate.half_width:.4f}{note}")

# The identified controller; yaw did not rotate in this flight, so it gets the lag of roll.
roll, pitch, yaw = found.rate_time_constant
mpc = dataclasses.replace(
    MpcConfig(),
    rate_time_constant=(roll.value, pitch.value, yaw.value if yaw.observable else roll.value),
    thrust_time_constant=found.thrust_time_constant.value,
    input_delay=found.input_delay.value,
)
