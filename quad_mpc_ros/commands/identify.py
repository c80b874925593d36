"""``quad_mpc identify``: lags, delay, thrust and drag of a vehicle from a recorded flight."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import cast

from quad_mpc_ros.analysis.identification import (
    identification_table,
    identify,
    measurements_of,
    parameter_file,
    write_fit_figure,
)
from quad_mpc_ros.analysis.recorded_parameters import recorded_parameters
from quad_mpc_ros.analysis.recorded_run import read_run
from quad_mpc_ros.commands.recording import bag_of, recorded_configuration, topic_names
from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.config import MpcConfig
from quad_mpc_ros.ros.topics import COMMAND


def identify_command(options: argparse.Namespace) -> int:
    """Fit, tell (the table on standard error), write; return the exit code."""
    for name, path in (("--out", options.out), ("--plot", options.plot)):
        _check_writable(name, path, overwrite=options.overwrite)
    bag = bag_of(options.bag)
    run = read_run(bag, topic_names(options), topics=(COMMAND,))
    mpc = cast(MpcConfig, recorded_configuration(options, run)["mpc"])
    data = measurements_of(run, vehicle=mpc.vehicle(), twist_frame=mpc.odometry.twist_frame)
    found = identify(data)
    # In lockstep a command takes no time of its own.
    lockstep = recorded_parameters(run.parameters, MpcConfig).get("lockstep", False)
    age = float("nan") if lockstep else data.command_age
    print(identification_table(found, mpc, command_age=age), file=sys.stderr)
    text = parameter_file(found, mpc, bag=bag, keep=options.keep)
    try:
        if options.out is None:
            print(text, end="")
        else:
            options.out.parent.mkdir(parents=True, exist_ok=True)
            options.out.write_text(text, encoding="utf-8")
            print(f"\nparameters  {options.out}", file=sys.stderr)
        if options.plot is not None:
            print(f"plot        {write_fit_figure(found, options.plot)}", file=sys.stderr)
    except OSError as error:
        raise UserError(f"{error.filename or bag}: cannot be written: {error.strerror}") from error
    return 0


def _check_writable(name: str, path: Path | None, *, overwrite: bool) -> None:
    if path is None:
        return
    if path.is_dir():
        raise UserError(f"{name}: {path} is a folder, expected a file")
    if path.exists() and not overwrite:
        raise UserError(
            f"{name}: {path} exists and is not overwritten; give another name or --overwrite"
        )
