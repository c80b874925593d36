"""The closed loop in one process and without ROS, in the order of a lockstep flight."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from quad_mpc_ros.control.tick import Tick
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.model.samples import OdometrySample, ReferenceWindow
from quad_mpc_ros.mpc_config import MpcConfig
from quad_mpc_ros.simulation.config import SimulatorConfig, make_plant
from quad_mpc_ros.simulation.odometry_stream import OdometryStream
from quad_mpc_ros.trajectories.config import ReferenceConfig
from quad_mpc_ros.trajectories.server import ReferenceServer
from quad_mpc_ros.trajectories.trajectory import Trajectory

# Simulated time does not start at zero, which ROS reads as "no time yet".
SIMULATION_START_NS = 1_000_000_000


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopStep:
    """One odometry of the loop; ``tick`` is None when the control rate skipped it.

    ``truth`` is the odometry without errors. It was measured at its stamp and sent at
    ``sent_ns``, when the command took effect or, with a delay, began its way.
    """

    odometry: OdometrySample
    truth: OdometrySample
    sent_ns: int
    window: ReferenceWindow
    tick: Tick | None


def fly(
    *,
    mpc: MpcConfig,
    simulator: SimulatorConfig,
    reference: ReferenceConfig,
    trajectory: Trajectory | None = None,
) -> Iterator[LoopStep]:
    """Fly the closed loop and yield every odometry that is sent with what followed from it.

    The values pass through the same boundary types as messages do, so the commands are those of
    a lockstep flight over DDS, bit for bit. ``trajectory`` is flown instead of the one that the
    reference's configuration asks for.
    """
    plant, controller = make_plant(simulator), warmed_up(mpc)
    server = ReferenceServer(reference, trajectory)
    stream = OdometryStream(plant, simulator, start_stamp_ns=SIMULATION_START_NS)
    server.start(SIMULATION_START_NS)
    while (sent := stream.step()) is not None:
        now_ns = SIMULATION_START_NS + sent.time_ns
        window = server.window(sent.odometry.stamp_ns)
        controller.receive_reference(window, now_ns=now_ns)
        tick = controller.receive_odometry(sent.odometry, now_ns=now_ns)
        if tick is not None and tick.command is not None:
            plant.apply(tick.command)
        yield LoopStep(
            odometry=sent.odometry, truth=sent.truth, sent_ns=now_ns, window=window, tick=tick
        )
