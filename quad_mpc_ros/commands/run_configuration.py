# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Configuration of a run: parameters of all nodes, trajectory, output folder."""

from __future__ import annotations

import argparse
import dataclasses
import shutil
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from quad_mpc_ros.commands.output import create_out, prepared_out, results_in
from quad_mpc_ros.commands.run_options import (
    DEFAULT_DURATION,
    DETOUR_SHARE,
    SETTLING_TIME,
)
from quad_mpc_ros.configuration import ConfigurationError, UserError, files
from quad_mpc_ros.configuration.arguments import number
from quad_mpc_ros.configuration.vehicle import disagreements
from quad_mpc_ros.control.config import MPC, MpcConfig
from quad_mpc_ros.recordings.config import RecorderConfig
from quad_mpc_ros.recordings.recording import SCENE_NAME
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory
from quad_mpc_ros.references.trajectory import Trajectory
from quad_mpc_ros.simulation.closed_loop import start_on
from quad_mpc_ros.simulation.config import SimulatorConfig, make_plant, plant_entry

_HALF_SPACES = 8  # per stage, with obstacles
_HasGates = TypeVar("_HasGates", MpcConfig, ReferenceConfig)

SCHEMA: files.Schema = {
    "mpc": MpcConfig,
    "simulator": SimulatorConfig,
    "reference": ReferenceConfig,
    "recorder": RecorderConfig,
}


@dataclass(frozen=True, kw_only=True)
class NodeConfigs:
    """Configuration of every node of a run."""

    mpc: MpcConfig
    simulator: SimulatorConfig
    reference: ReferenceConfig
    recorder: RecorderConfig


@dataclass(frozen=True, kw_only=True)
class RunConfig(NodeConfigs):
    """Configuration of every node of a run, its trajectory and its output folder."""

    trajectory: Trajectory
    out: Path


def run_configuration(options: argparse.Namespace, *, lockstep: bool) -> RunConfig:
    """Return the configuration of a run, and create the folder if the configuration is valid.

    Raises :class:`UserError` for invalid options.
    """
    made = [*_assignments(options, lockstep=lockstep), *_of_obstacles(options)]
    loaded = _loaded(options, made)
    reference = _with_course(loaded.reference)
    trajectory = configured_trajectory(reference)
    start: dict[str, Any] = {}
    made += _duration(options, loaded, trajectory)
    if _starts_on_reference(options, trajectory, reference):
        start = _start_on(trajectory, loaded.simulator)
        # The start in a file has priority, unless the option is given.
        if options.start is not None:
            made += [
                f"simulator.{name}={files.value_text(value)}" for name, value in start.items()
            ]
    loaded = _loaded(options, made, start=start)
    _check_imu(loaded.mpc, loaded.simulator)
    make_plant(loaded.simulator)  # fails if a package is missing
    mpc = _with_course(loaded.mpc)
    _check_controller(mpc.controller)
    out = prepared_out(options.out or create_out(reference.trajectory))
    nodes = {node: getattr(loaded, node).vehicle_values() for node in SCHEMA}
    if differ := disagreements(nodes):
        text = "; ".join(differ.values())
        print(f"warning: the nodes have different vehicle parameters: {text}", file=sys.stderr)
    mpc, simulator = _with_own_file(mpc, loaded.simulator, out)
    return RunConfig(
        mpc=mpc,
        simulator=simulator,
        reference=reference,
        recorder=dataclasses.replace(loaded.recorder, directory=str(out / "bag")),
        trajectory=trajectory,
        out=out,
    )


def _loaded(
    options: argparse.Namespace, made: Sequence[str], *, start: Mapping[str, Any] | None = None
) -> NodeConfigs:
    """Return the parameters in the files, of which the plant's is the first, and assignments."""
    plant = plant_entry(options.plant) if options.plant is not None else None
    preset = [plant.preset] if plant is not None and plant.preset else []
    loaded: dict[str, Any] = files.load(
        [*preset, *(options.config or ["default"])],
        [*made, *options.assignments],
        schema=SCHEMA,
        base={"simulator": dict(start or {})},
    )
    return NodeConfigs(**loaded)


def _check_imu(mpc: MpcConfig, simulator: SimulatorConfig) -> None:
    """Raise :class:`UserError` if odometries in lockstep would wait for an accelerometer."""
    if mpc.uses_accelerometer and mpc.lockstep and simulator.imu_rate == 0.0:
        raise ConfigurationError(
            "simulator.imu_rate",
            simulator.imu_rate,
            "a number above 0 with mpc.advanced.accelerometer_noise",
        )


def _check_controller(name: str) -> None:
    """Raise :class:`UserError` for an unknown controller."""
    if name != MPC:
        from quad_mpc_ros.extras.controllers.registry import controller_class

        controller_class(name)


def _of_obstacles(options: argparse.Namespace) -> list[str]:
    """Return ``--obstacles`` and ``--sensor`` as assignments.

    Raises :class:`UserError` for a file that cannot be used.
    """
    file: Path | None = options.obstacles
    if file is None:
        if options.sensor is not None:
            raise UserError(f"--sensor: given {options.sensor}, needs --obstacles FILE")
        return []
    from quad_mpc_ros.extras.obstacles.files import read_scene

    scene, text = read_scene(file), files.value_text(str(file.resolve()))
    made = [f"mpc.obstacles.half_spaces={_HALF_SPACES}", f"simulator.obstacles.file={text}"]
    sensor = options.sensor
    if sensor is None:
        made.append(f"mpc.obstacles.file={text}")
        sensor = "markers" if scene.changes else None
    return made if sensor is None else [*made, f"simulator.obstacles.sensor={sensor}"]


def _with_own_file(
    mpc: MpcConfig, simulator: SimulatorConfig, out: Path
) -> tuple[MpcConfig, SimulatorConfig]:
    """Return the parameters with a copy of the file of obstacles in the folder of the run."""
    given = simulator.obstacles.file
    if not given:
        return mpc, simulator
    from quad_mpc_ros.extras.obstacles.files import read_scene

    read_scene(given)
    copy = out / SCENE_NAME
    with results_in(out):
        shutil.copyfile(given, copy)
    where = {"obstacles.file": str(copy.resolve())}
    same = mpc.obstacles.file == given
    return mpc.updated(where) if same else mpc, simulator.updated(where)


def _with_course(config: _HasGates) -> _HasGates:
    """Replace the gate file by its content, so that the bag contains the gates."""
    if not config.gates:
        return config
    from quad_mpc_ros.extras.racing.gates import course_text

    return dataclasses.replace(config, gates=course_text(config.gates))


def _starts_on_reference(
    options: argparse.Namespace, trajectory: Trajectory, reference: ReferenceConfig
) -> bool:
    if reference.mode == "at_once":
        return (options.start or ("reference" if trajectory.smooth else "ground")) == "reference"
    if options.start == "reference":
        raise UserError(
            f"--start: given 'reference', expected 'ground' with reference.mode={reference.mode}"
        )
    return False


def _assignments(options: argparse.Namespace, *, lockstep: bool) -> list[str]:
    """Return the options as assignments; explicit assignments have precedence."""
    made = [
        f"{node}.lockstep={str(lockstep).lower()}" for node in ("mpc", "simulator", "reference")
    ]
    if options.plant is not None:
        made.append(f"simulator.plant={options.plant}")
    if options.gates is not None:
        made.append(f"mpc.gates={files.value_text(options.gates)}")
    return made + reference_assignments(options)


def reference_assignments(options: argparse.Namespace) -> list[str]:
    """Return ``--reference`` and ``--gates`` as assignments; explicit ones have precedence."""
    made = []
    if options.gates is not None:
        made.append(f"reference.gates={files.value_text(options.gates)}")
    if options.reference is not None or options.gates is not None:
        made.append(f"reference.trajectory={options.reference or 'gates'}")
    return made


def _duration(
    options: argparse.Namespace, loaded: NodeConfigs, trajectory: Trajectory
) -> list[str]:
    """Return the duration as an assignment: from the option, a file or the task.

    By default a flight lasts one lap of its trajectory, and a little longer.
    """
    mpc, duration = loaded.mpc, options.duration
    if duration is not None:
        number(duration, "--duration", above=0.0)
    elif loaded.simulator.duration:  # 0, endless, is for a simulator by itself
        return []
    else:
        detours = mpc.formulation == "contouring" or mpc.obstacles.half_spaces > 0
        task = (DETOUR_SHARE if detours else 1.0) * 1e-9 * trajectory.period_ns + SETTLING_TIME
        duration = max(DEFAULT_DURATION, task)
    return [f"simulator.duration={files.value_text(duration)}"]


def _start_on(trajectory: Trajectory, simulator: SimulatorConfig) -> dict[str, Any]:
    """Return the parameters that start the simulator in motion on a trajectory.

    Raises :class:`UserError` if the simulated vehicle has not enough throttle.
    """
    try:
        return start_on(trajectory, simulator)
    except ValueError as error:
        raise UserError(f"--start reference: {error}; use --start ground") from error
