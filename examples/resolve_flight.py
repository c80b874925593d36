# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Recompute the commands of a recorded flight: python examples/resolve_flight.py [BAG]

The recorded odometry does not change; only the commands are computed again. With the recorded
parameters the commands equal the recorded commands, bit for bit.
"""

import dataclasses
import sys
import tempfile
from pathlib import Path

import numpy as np

from quad_mpc_ros import MpcConfig, Recording
from quad_mpc_ros.cli import main
from quad_mpc_ros.recordings.replay.resolution import resolve

if len(sys.argv) > 1:
    bag = Path(sys.argv[1])
else:
    bag = Path(tempfile.mkdtemp()) / "run"
    main(["simulate", "--duration", "6", "--out", str(bag)])

recording = Recording(bag)
run = recording.run()
recorded = {sent.value.stamp_ns: sent.value for sent in run.commands}
as_flown = MpcConfig.build(recording.parameters_of(MpcConfig))

difference = {}
for name, mpc in {
    "as flown": as_flown,
    "longer horizon": dataclasses.replace(as_flown, horizon_steps=20),
    "no terminal weight": dataclasses.replace(as_flown, terminal_weight=1.0),
}.items():
    commands = [step.tick.command for step in resolve(run, mpc) if step.tick is not None]
    rates = [c.w_WB_B - recorded[c.stamp_ns].w_WB_B for c in commands if c is not None]
    difference[name] = float(np.abs(rates).max())
    print(f"{name:20} body rates differ by at most {difference[name]:.4f} rad/s")
