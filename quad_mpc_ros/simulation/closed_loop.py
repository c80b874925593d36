"""The closed loop in one process and without ROS, in the order of a lockstep flight."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.controller import Controller, Tick
from quad_mpc_ros.core.messages import OdometrySample, ReferenceWindow
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.server import ReferenceServer
from quad_mpc_ros.simulation.config import SimulatorConfig
from quad_mpc_ros.simulation.plant import Plant

# Simulated time does not start at zero, which ROS reads as "no time yet".
SIMULATION_START_NS = 1_000_000_000


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopStep:
    """One odometry of the loop; ``tick`` is None when the control rate skipped it."""

    odometry: OdometrySample
    window: ReferenceWindow
    tick: Tick | None


def odometry_stamps(config: SimulatorConfig) -> Iterator[int]:
    """Yield the times of the odometries from the start [ns], for the configured duration.

    Each is computed from its number, so that no rounding accumulates.
    """
    count = round(config.duration * config.odom_rate) if config.duration > 0.0 else None
    number = 0
    while count is None or number < count:
        yield round(number * 1e9 / config.odom_rate)
        number += 1


def fly(
    *, mpc: MpcConfig, simulator: SimulatorConfig, reference: ReferenceConfig
) -> Iterator[LoopStep]:
    """Fly the closed loop and yield every odometry with what followed from it.

    The values pass through the same boundary types as messages do, so the commands are those of
    a lockstep flight over DDS, bit for bit.
    """
    plant, server, controller = Plant(simulator), ReferenceServer(reference), Controller(mpc)
    server.start(SIMULATION_START_NS)
    for time_ns in odometry_stamps(simulator):
        plant.advance_to(time_ns)
        stamp_ns = SIMULATION_START_NS + time_ns
        odometry, window = plant.odometry(stamp_ns), server.window(stamp_ns)
        controller.receive_reference(window, now_ns=stamp_ns)
        tick = controller.receive_odometry(odometry, now_ns=stamp_ns)
        if tick is not None and tick.command is not None:
            plant.apply(tick.command)
        yield LoopStep(odometry=odometry, window=window, tick=tick)
