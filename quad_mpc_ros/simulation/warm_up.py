"""Compile a plant before its first step, which in real time must not wait."""

from __future__ import annotations

import numpy as np

from quad_mpc_ros.control.model.samples import CommandSample
from quad_mpc_ros.simulation.config import SimulatorConfig, make_plant
from quad_mpc_ros.simulation.sensors import OdometryStream

_STEPS = 4


def warm_up(config: SimulatorConfig) -> None:
    """Fly a plant like the configured one for a few odometries, and discard it."""
    plant = make_plant(config)
    stream = OdometryStream(plant, config, start_stamp_ns=0)
    for step in range(_STEPS):
        sent = stream.step()
        if sent is None:
            return
        plant.apply(
            CommandSample(
                stamp_ns=sent.odometry.stamp_ns, throttle=0.5, w_WB_B=np.array([0.1, 0.0, step])
            )
        )
