# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The closed loop in one process and without ROS, in the order of a lockstep flight."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from quad_mpc_ros.configuration import ConfigurationError, optional_part
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.control.control_law import ControlLaw
from quad_mpc_ros.control.controller import Controller
from quad_mpc_ros.control.lie import so3
from quad_mpc_ros.control.model.samples import (
    CommandSample,
    ImuSample,
    OdometrySample,
    ReferenceWindow,
    RotorCommand,
)
from quad_mpc_ros.control.tick import Tick
from quad_mpc_ros.control.warm_up import warmed_up
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.references.flat_trajectory import FlatTrajectory
from quad_mpc_ros.references.path import Path
from quad_mpc_ros.references.server import ReferenceServer, WindowsAhead
from quad_mpc_ros.references.trajectory import Trajectory
from quad_mpc_ros.simulation.config import SimulatorConfig, make_plant
from quad_mpc_ros.simulation.plant import SIMULATION_START_NS, Plant
from quad_mpc_ros.simulation.sensors import (
    OdometryStream,
    SentOdometry,
    odometry_stamps,
    stamp_offset_ns,
)
from quad_mpc_ros.simulation.shapes import Scene
from quad_mpc_ros.simulation.surroundings import (
    NOTHING_SENSED,
    Collision,
    ObstacleReceiver,
    SensedObstacles,
    configured_surroundings,
)

_DEFAULT_DURATION = 10.0  # s

CommandFunction = Callable[[OdometrySample, ReferenceWindow], CommandSample | None]
"""Returns the command for an odometry, or None to keep the last command; nothing is checked."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopStep:
    """One odometry of the loop and its results.

    Attributes:
        odometry: The measured odometry.
        truth: The odometry without errors.
        sent_ns: Time of its publication [ns], at which the command was sent to the plant.
        window: The reference from the odometry's stamp on.
        tick: Tick of the controller; None if the control rate skipped the odometry, and with a
            function.
        command: The command sent to the plant, if any.
        voltage: Voltage of the battery [V], if measured with the odometry.
        imu: IMU samples since the last odometry, delivered before the odometry.
        collision: A collision since the previous step, which ends the flight.
    """

    odometry: OdometrySample
    truth: OdometrySample
    sent_ns: int
    window: ReferenceWindow
    tick: Tick | None
    command: CommandSample | None
    voltage: float | None = None
    imu: tuple[ImuSample, ...] = ()
    collision: Collision | None = None


def fly(
    *,
    mpc: MpcConfig | None = None,
    simulator: SimulatorConfig | None = None,
    reference: ReferenceConfig | None = None,
    plant: Plant | None = None,
    trajectory: Trajectory | Path | None = None,
    controller: Controller | ControlLaw | CommandFunction | None = None,
    scene: Scene | None = None,
    world: ObstacleReceiver | None = None,
    on_reference: bool = False,
) -> Iterator[LoopStep]:
    """Fly the closed loop and yield a step for every published odometry.

    The values pass through the same boundary types as messages, so the commands equal those of a
    lockstep flight over DDS, bit for bit. The iterator advances the flight.

    Arguments as in :func:`quad_mpc_ros.simulate`, which returns the steps as arrays. Without
    ``simulator`` the flight takes ten seconds, otherwise its ``duration``. A path is flown by
    differential flatness, with the vehicle and the yaw of ``reference``. A given ``plant`` keeps
    its state, also with ``on_reference``. A ``scene`` replaces the simulator's file of obstacles;
    the flight ends at a collision. A ``world`` receives the sensor's messages for the guide of a
    given controller.

    Raises:
        UserError: For parameters that cannot be used together, a trajectory that the vehicle
            cannot fly, or a start in an obstacle.
        ValueError: With ``on_reference``, if the initial thrust is beyond the vehicle's throttle.
    """
    simulator = simulator or SimulatorConfig(duration=_DEFAULT_DURATION)
    reference = reference or ReferenceConfig()
    flown = _trajectory(reference, trajectory)
    if on_reference:
        simulator = simulator.updated(start_on(flown, simulator))
    plant = plant or make_plant(simulator)
    if controller is None or isinstance(controller, ControlLaw):
        mpc = mpc or MpcConfig()
        world, guide = None, None
        if mpc.guided_by:
            guidance = optional_part("guidance", needed_by=mpc.guided_by)(mpc)
            world, guide = guidance.world, guidance.guide
        controller = warmed_up(mpc, guide=guide, law=controller)
    server = ReferenceServer(reference, flown)
    stream = OdometryStream(plant, simulator, start_stamp_ns=SIMULATION_START_NS)
    server.start(SIMULATION_START_NS)
    first_ns = SIMULATION_START_NS + stamp_offset_ns(simulator)
    ahead = WindowsAhead(server, (first_ns + time_ns for time_ns in odometry_stamps(simulator)))
    around = configured_surroundings(simulator.obstacles, radius=simulator.radius, scene=scene)
    if around is not None:
        around.check_start(plant.odometry(SIMULATION_START_NS).p_WB)
    while (sent := stream.step()) is not None:
        now_ns = SIMULATION_START_NS + sent.time_ns
        window = ahead.window(sent.odometry.stamp_ns)
        measured_ns = sent.truth.stamp_ns - SIMULATION_START_NS
        sensed, collision = NOTHING_SENSED, None
        if around is not None:
            sensed = around.look(sent.truth, measured_ns)
            collision = around.collision(sent.truth, measured_ns)
        if world is not None:
            world.receive_odometry(sent.odometry)
        tick, command = _answered(controller, sent, window, now_ns=now_ns)
        if command is not None:
            if isinstance(command, RotorCommand) and not getattr(plant, "follows_rotors", False):
                expected = "rotors, or another plant with rotors; the controller commands rotors"
                raise ConfigurationError("simulator.plant", simulator.plant, expected)
            plant.apply(command)
        if world is not None:
            _deliver(world, sensed)
        yield LoopStep(
            odometry=sent.odometry,
            truth=sent.truth,
            sent_ns=now_ns,
            window=window,
            tick=tick,
            command=command,
            voltage=sent.voltage,
            imu=sent.imu,
            collision=collision,
        )
        if collision is not None:
            return


def start_on(trajectory: Trajectory, simulator: SimulatorConfig) -> dict[str, Any]:
    """Return the parameters with which the simulator starts in motion on a trajectory.

    Raises ``ValueError`` if the initial thrust is beyond the vehicle's throttle.
    """
    start = trajectory.at([0])
    R_WB = so3.rotation_from_quaternion_xyzw(start.q_WB_xyzw[0])
    vehicle = simulator.vehicle()
    thrust = vehicle.specific_thrust(a_WB_W=start.a_WB_W, v_WB_W=start.v_WB_W, R_WB=R_WB[None])
    return {
        "initial_position": start.p_WB[0].tolist(),
        "initial_velocity": start.v_WB_W[0].tolist(),
        "initial_attitude": start.q_WB_xyzw[0].tolist(),
        "initial_body_rates": (R_WB.T @ start.w_WB_W[0]).tolist(),
        "initial_throttle": vehicle.throttle_for(vehicle.mass * float(thrust[0])),
    }


def _answered(
    controller: Controller | CommandFunction,
    sent: SentOdometry,
    window: ReferenceWindow,
    *,
    now_ns: int,
) -> tuple[Tick | None, CommandSample | None]:
    if not isinstance(controller, Controller):
        return None, controller(sent.odometry, window)
    for sample in sent.imu:
        controller.receive_imu(sample)
    controller.receive_reference(window, now_ns=now_ns)
    tick = controller.receive_odometry(sent.odometry, now_ns=now_ns)
    return tick, None if tick is None else tick.command


def _deliver(world: ObstacleReceiver, sensed: SensedObstacles) -> None:
    """Deliver sensed obstacles for the next tick, like the node in lockstep."""
    if sensed.cloud is not None:
        world.receive_cloud(sensed.cloud)
    if sensed.markers:
        world.receive_markers(sensed.markers)


def _trajectory(reference: ReferenceConfig, given: Trajectory | Path | None) -> Trajectory:
    if given is None:
        return configured_trajectory(reference)
    if isinstance(given, Trajectory):
        return given
    return FlatTrajectory(given, reference, yaw=reference.yaw)
