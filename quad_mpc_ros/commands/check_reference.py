"""``quad_mpc check-reference``: whether the vehicle can fly a reference, before it does."""

from __future__ import annotations

import argparse
import datetime
from pathlib import Path
from typing import cast

from quad_mpc_ros.commands.run_options import SCHEMA, add_configuration_options
from quad_mpc_ros.commands.verdict_table import verdict_table
from quad_mpc_ros.configuration import UserError, files
from quad_mpc_ros.evaluation.recorded_reference import read_recording
from quad_mpc_ros.figures.reference_figure import write_reference
from quad_mpc_ros.mpc_config import MpcConfig
from quad_mpc_ros.trajectories.catalogue import judged_trajectory
from quad_mpc_ros.trajectories.config import ReferenceConfig
from quad_mpc_ros.trajectories.feasibility import Verdict

EXIT_INFEASIBLE = 1
_FIGURE = "reference.png"


def add_check_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_configuration_options(parser)
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help=f"folder for {_FIGURE}; must not hold one (default: runs/<date-time>_<reference>)",
    )


def check_reference(options: argparse.Namespace) -> int:
    """Judge, show and draw; return the exit code."""
    assignments = list(options.assignments)
    if options.reference is not None:
        assignments.insert(0, f"reference.trajectory={options.reference}")
    loaded = files.load(options.config or ["default"], assignments, schema=SCHEMA)
    config = cast(ReferenceConfig, loaded["reference"])
    trajectory, verdict = judged_trajectory(config, read_bag=read_recording)
    figure = _figure_path(options.out, config.trajectory)
    times = [round(1e9 * seconds) for seconds in verdict.over_time.seconds]
    try:
        write_reference(config.trajectory, trajectory.at(times), verdict, figure)
    except OSError as error:
        raise UserError(f"--out: {figure} cannot be written: {error.strerror}") from error
    print(f"{config.trajectory}\n\n{verdict_table(verdict)}")
    for remark in _beyond_the_controller(verdict, cast(MpcConfig, loaded["mpc"])):
        print(remark)
    print(f"\nfigure  {figure}")
    return 0 if verdict.feasible else EXIT_INFEASIBLE


def _beyond_the_controller(verdict: Verdict, mpc: MpcConfig) -> list[str]:
    """Return a remark for each rate that the reference may have and the MPC may not command."""
    return [
        f"note: {need.name} {need.worst:.4g} rad/s is beyond mpc.omega_max, {bound:.4g}: the MPC "
        "cannot follow it there exactly"
        for need, bound in zip(
            (need for need in verdict.needs if need.name.endswith("rate")),
            mpc.omega_max,
            strict=True,
        )
        if need.worst > bound
    ]


def _figure_path(out: Path | None, name: str) -> Path:
    if out is None:
        now = datetime.datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
        out = Path("runs") / f"{now}_{name}"
    if (out / _FIGURE).exists():
        raise UserError(f"--out: {out / _FIGURE} exists and is not overwritten; give a new folder")
    return out / _FIGURE
