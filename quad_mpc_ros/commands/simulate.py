# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc simulate``: closed loop in one process, without ROS."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

from quad_mpc_ros.analysis.figures import write_figures
from quad_mpc_ros.commands.output import prepared_out, results_in, write_json
from quad_mpc_ros.commands.progress import ProgressLine
from quad_mpc_ros.commands.results import finish
from quad_mpc_ros.commands.run_configuration import SCHEMA, run_configuration
from quad_mpc_ros.commands.run_options import add_run_options
from quad_mpc_ros.commands.run_recorder import RunRecorder
from quad_mpc_ros.configuration import ConfigurationError
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.messages import cdr, topics
from quad_mpc_ros.recordings.evaluation.metrics import summarise
from quad_mpc_ros.recordings.evaluation.simulated import simulate
from quad_mpc_ros.recordings.flight import Flight
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.server import ReferenceServer
from quad_mpc_ros.simulation.closed_loop import LoopStep, fly
from quad_mpc_ros.simulation.config import PLANTS, SimulatorConfig, make_plant
from quad_mpc_ros.simulation.plant import SIMULATION_START_NS


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a run, and the plant."""
    parser.description = (
        "Fly the closed loop in one process, without ROS. Writes the same files as 'fly'; the "
        "commands equal 'fly --lockstep', bit for bit."
    )
    add_run_options(parser)
    parser.add_argument(
        "--plant",
        metavar="NAME",
        help=f"simulated vehicle: {', '.join(PLANTS)} (default: simulator.plant, internal); "
        "betaflight, mujoco, rotorpy and rotors have a preset, which --config and --set override",
    )


def run(options: argparse.Namespace) -> int:
    """Fly, record and evaluate; return the exit code."""
    config = run_configuration(options, lockstep=True)
    if config.reference.mode != "at_once":
        raise ConfigurationError(
            "reference.mode", config.reference.mode, "at_once: simulate takes no requests"
        )
    progress = ProgressLine()
    print(f"simulating the {config.reference.trajectory} into {config.out}", file=sys.stderr)
    started = time.monotonic()
    plant = make_plant(config.simulator)
    with RunRecorder(
        config.out / "bag",
        parameters={node: getattr(config, node).flattened() for node in SCHEMA},
        frame_id=config.mpc.odometry.frame_id,
        compression=config.recorder.compression,
    ) as recorder:
        whole = ReferenceServer(config.reference, config.trajectory).whole()
        recorder.reference_path(whole, stamp_ns=SIMULATION_START_NS)
        for step in fly(
            mpc=config.mpc,
            simulator=config.simulator,
            reference=config.reference,
            plant=plant,
            trajectory=config.trajectory,
        ):
            _record(recorder, step)
            flown = (step.odometry.stamp_ns - SIMULATION_START_NS) * 1e-9
            progress.show_flight(flown, config.simulator.duration)
    wall_seconds = time.monotonic() - started
    progress.close()
    return finish(config.out, wall_seconds=wall_seconds)


def simulate_run(
    out: Path,
    mpc: MpcConfig | None = None,
    simulator: SimulatorConfig | None = None,
    reference: ReferenceConfig | None = None,
    **options: Any,
) -> Flight:
    """Fly like :func:`.simulate`, and save the run like ``quad_mpc simulate``.

    Args:
        out: New folder of the run.
        mpc: Configuration of the controller; :func:`.simulate` describes this and all options.
        simulator: Configuration of the simulated vehicle.
        reference: Configuration of the reference.
        **options: Other arguments of :func:`.simulate`.

    Returns:
        The flight.

    Raises:
        UserError: For a folder that has a run or cannot be written.
    """
    out, steps = prepared_out(Path(out)), list[LoopStep]()
    flight = simulate(mpc, simulator, reference, observe=steps.append, **options)
    frame_id = steps[0].odometry.frame_id
    with RunRecorder(out / "bag", parameters=flight.parameters, frame_id=frame_id) as recorder:
        for step in steps:
            _record(recorder, step)
    with results_in(out):
        write_json(out / "summary.json", summarise(flight))
        write_figures(flight, out / "figures")
    return flight


def _record(recorder: RunRecorder, step: LoopStep) -> None:
    """Write one odometry and its consequences."""
    odometry, stamp_ns = step.odometry, step.odometry.stamp_ns
    for sample in step.imu:
        recorder.write(topics.IMU, cdr.written_imu(sample), time_ns=sample.stamp_ns)
    recorder.write(topics.ODOMETRY, cdr.written_odometry(odometry), time_ns=stamp_ns)
    if step.voltage is not None:
        data = cdr.written_battery(step.voltage, stamp_ns=stamp_ns)
        recorder.write(topics.BATTERY, data, time_ns=stamp_ns)
    data = cdr.written_reference(step.window, child_frame_id=odometry.child_frame_id)
    recorder.write(topics.REFERENCE, data, time_ns=stamp_ns)
    if step.tick is not None:
        recorder.tick(step.tick, time_ns=stamp_ns)
    recorder.flush_if_due()
