# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Read a recorded flight into arrays: python examples/read_bag.py [BAG]

BAG is a rosbag2 directory, an .mcap file or the folder of a run. Without BAG, a flight is
simulated.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from quad_mpc_ros import Recording, summarise
from quad_mpc_ros.cli import main

if len(sys.argv) > 1:
    bag = Path(sys.argv[1])
else:
    bag = Path(tempfile.mkdtemp()) / "run"
    main(["simulate", "--duration", "6", "--out", str(bag)])

recording = Recording(bag)
for name, topic in recording.bag.topics.items():
    print(f"{name:24}{topic.type_name}")

flight = recording.flight()
print(f"{len(flight.time)} odometries in {flight.time[-1]:.1f} s")
print(f"flown through {flight.p_WB.min(axis=0).round(2)} to {flight.p_WB.max(axis=0).round(2)} m")
print(f"fastest at {np.linalg.norm(flight.v_WB_B, axis=1).max():.1f} m/s")
print(f"throttle {flight.commands.throttle.min():.2f} to {flight.commands.throttle.max():.2f}")
print(f"horizon of {flight.mpc.horizon_steps} steps of {flight.mpc.horizon_step} s")
summary = summarise(flight)
print(f"position RMSE {summary['position_rmse_m']:.3f} m, {summary['fallbacks']} fallbacks")
