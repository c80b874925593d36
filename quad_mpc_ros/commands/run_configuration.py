"""The configuration of a run: every node's parameters, what is flown, where results go."""

from __future__ import annotations

import argparse
import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import yaml

from quad_mpc_ros.commands.output import default_out, prepared_out
from quad_mpc_ros.commands.run_options import DEFAULT_DURATION, check_duration
from quad_mpc_ros.configuration import UserError, files
from quad_mpc_ros.mpc_config import MpcConfig
from quad_mpc_ros.recordings.config import RecorderConfig
from quad_mpc_ros.recordings.recording import flown_points
from quad_mpc_ros.simulation.closed_loop import start_on
from quad_mpc_ros.simulation.config import SimulatorConfig, make_plant, plant_entry
from quad_mpc_ros.trajectories.config import ReferenceConfig
from quad_mpc_ros.trajectories.configured import configured_trajectory
from quad_mpc_ros.trajectories.trajectory import Trajectory

SCHEMA: files.Schema = {
    "mpc": MpcConfig,
    "simulator": SimulatorConfig,
    "reference": ReferenceConfig,
    "recorder": RecorderConfig,
}


@dataclass(frozen=True, kw_only=True)
class RunConfig:
    """The configuration of every node of a run, what it flies, where its results go."""

    mpc: MpcConfig
    simulator: SimulatorConfig
    reference: ReferenceConfig
    recorder: RecorderConfig
    trajectory: Trajectory
    out: Path

    @property
    def bag(self) -> Path:
        """Folder of the recorded bag."""
        return self.out / "bag"


def run_configuration(options: argparse.Namespace, *, lockstep: bool) -> RunConfig:
    """Return the configuration of a run, its folder made and empty.

    Raises :class:`UserError` for anything that cannot be used.
    """
    sources, made = _sources(options), _assignments(options, lockstep=lockstep)
    loaded = files.load(sources, [*made, *options.assignments], schema=SCHEMA)
    reference = cast(ReferenceConfig, loaded["reference"])
    trajectory = configured_trajectory(reference, read_bag=flown_points)
    if _starts_on_reference(options, trajectory, reference):
        made += _start_on(trajectory, cast(SimulatorConfig, loaded["simulator"]))
        loaded = files.load(sources, [*made, *options.assignments], schema=SCHEMA)
    make_plant(cast(SimulatorConfig, loaded["simulator"]))  # is what it needs installed?
    out = prepared_out(options.out or default_out(reference.trajectory))
    return RunConfig(
        mpc=cast(MpcConfig, loaded["mpc"]),
        simulator=cast(SimulatorConfig, loaded["simulator"]),
        reference=reference,
        recorder=dataclasses.replace(
            cast(RecorderConfig, loaded["recorder"]), directory=str(out / "bag")
        ),
        trajectory=trajectory,
        out=out,
    )


def _sources(options: argparse.Namespace) -> list[str]:
    """Return the parameter files, that of the plant first."""
    plant = plant_entry(options.plant) if options.plant is not None else None
    preset = [plant.preset] if plant is not None and plant.preset else []
    return [*preset, *(options.config or ["default"])]


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
    """Return the options as assignments, to come before the explicit ones, which win."""
    duration = DEFAULT_DURATION if options.duration is None else options.duration
    check_duration(duration)
    made = [f"simulator.duration={duration}"]
    made += [
        f"{node}.lockstep={str(lockstep).lower()}" for node in ("mpc", "simulator", "reference")
    ]
    if options.plant is not None:
        made.append(f"simulator.plant={options.plant}")
    if options.reference is not None:
        made.append(f"reference.trajectory={options.reference}")
    return made


def _start_on(trajectory: Trajectory, simulator: SimulatorConfig) -> list[str]:
    """Return the assignments that start the simulator in motion on a trajectory.

    Raises :class:`UserError` when the simulator's vehicle has no throttle for it.
    """
    try:
        values = start_on(trajectory, simulator)
    except ValueError as error:
        raise UserError(f"--start reference: {error}; --start ground needs none") from error
    return [f"simulator.{name}={_yaml(value)}" for name, value in values.items()]


def _yaml(value: float | list[float]) -> str:
    """Return a value as YAML reads it back exactly, which it does not with every ``repr``."""
    return yaml.safe_dump([value], default_flow_style=True, width=math.inf).strip()[1:-1]
