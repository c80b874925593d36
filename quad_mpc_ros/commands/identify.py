"""``quad_mpc identify``: lags, delay, thrust and drag of a vehicle from a recorded flight."""

from __future__ import annotations

import argparse
import sys
from typing import cast

from quad_mpc_ros.commands.new_file import check_writable, write_new
from quad_mpc_ros.commands.recording import bag_of, recorded_configuration, topic_names
from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.identification import (
    identification_table,
    identify,
    measurements_of,
    parameter_file,
    write_fit_figure,
)
from quad_mpc_ros.messages.topics import COMMAND, ENGAGED
from quad_mpc_ros.mpc_config import MpcConfig
from quad_mpc_ros.recordings.parameters import recorded_parameters
from quad_mpc_ros.recordings.recorded_run import read_run


def identify_command(options: argparse.Namespace) -> int:
    """Fit, tell (the table on standard error), write; return the exit code."""
    for name, path in (("--out", options.out), ("--plot", options.plot)):
        check_writable(name, path, overwrite=options.overwrite)
    bag = bag_of(options.bag)
    run = read_run(bag, topic_names(options), topics=(COMMAND, ENGAGED))
    mpc = cast(MpcConfig, recorded_configuration(options, run)["mpc"])
    data = measurements_of(run, vehicle=mpc.vehicle(), twist_frame=mpc.odometry.twist_frame)
    found = identify(data)
    # In lockstep a command takes no time of its own.
    lockstep = recorded_parameters(run.parameters, MpcConfig).get("lockstep", False)
    age = float("nan") if lockstep else data.command_age
    print(identification_table(found, mpc, command_age=age), file=sys.stderr)
    text = parameter_file(found, mpc, bag=bag, keep=options.keep)
    if options.out is None:
        print(text, end="")
    else:
        write_new("--out", options.out, text, overwrite=options.overwrite)
        print(f"\nparameters  {options.out}", file=sys.stderr)
    if options.plot is not None:
        try:
            print(f"plot        {write_fit_figure(found, options.plot)}", file=sys.stderr)
        except OSError as error:
            raise UserError(
                f"--plot: {options.plot} cannot be written: {error.strerror}"
            ) from error
    return 0
