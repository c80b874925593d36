"""Identifying a vehicle from a recorded flight: python examples/identify_vehicle.py [BAG]

Without a bag, one is simulated with lags and a delay that the controller does not know of.
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
    estimate = getattr(found, name)
    print(f"{name:22}{estimate.value:8.4f} +- {estimate.half_width:.4f}")

# The controller that knows them.
mpc = dataclasses.replace(
    MpcConfig(),
    rate_time_constant=found.rate_time_constant.value,
    thrust_time_constant=found.thrust_time_constant.value,
    input_delay=found.input_delay.value,
)
