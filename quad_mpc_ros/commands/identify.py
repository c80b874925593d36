"""``quad_mpc identify``: lags, delay, thrust and drag of a vehicle from a recorded flight."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from quad_mpc_ros.commands import recording
from quad_mpc_ros.commands.output import check_writable, write_new
from quad_mpc_ros.commands.save_vehicle import add_vehicle_file_options
from quad_mpc_ros.configuration import UserError

if TYPE_CHECKING:
    from quad_mpc_ros.recordings.run import RecordedRun


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the bag, and where to write what was found."""
    parser.description = (
        "Fit the lags of body rates and thrust, the input delay, the thrust per mass, over the "
        "battery's voltage if that was recorded, and the drag to the commands and the odometry "
        "of a flight. Prints the vehicle file, ROS parameters for every node below /**, on "
        "standard output, and what was found with its 95 % intervals on standard error."
    )
    recording.add_options(parser)
    parser.add_argument(
        "--battery-topic",
        default="",
        metavar="NAME",
        help="sensor_msgs/BatteryState, or BatteryStatus of px4_msgs or rosflight_msgs (default: "
        "the only one in the bag)",
    )
    add_vehicle_file_options(parser)
    parser.add_argument(
        "--plot", type=Path, metavar="PNG", help="draw measured and fitted rates and thrust"
    )
    parser.add_argument(
        "--overwrite", action="store_true", help="let --out and --plot replace existing files"
    )


def run(options: argparse.Namespace) -> int:
    """Fit, print the table on standard error, write; return the exit code."""
    from quad_mpc_ros.analysis.identification.figure import write_fit_figure
    from quad_mpc_ros.analysis.identification.fit import fit
    from quad_mpc_ros.analysis.identification.measurements import (
        RECORDED,
        measurements_of,
        recorded_voltage_map,
    )
    from quad_mpc_ros.analysis.identification.report import identification_table, parameter_file
    from quad_mpc_ros.control.config import MpcConfig

    for name, path in (("--out", options.out), ("--plot", options.plot)):
        check_writable(name, path, overwrite=options.overwrite)
    bag = recording.opened(options.bag)
    run = bag.run(recording.topic_names(options), topics=RECORDED)
    mpc = cast("MpcConfig", recording.configuration(options, run)["mpc"])
    bridge = _bridge(options, run)
    data = measurements_of(
        run,
        vehicle=mpc.vehicle(),
        twist_frame=mpc.odometry.twist_frame,
        voltage_map=recorded_voltage_map({"bridge": bridge}),
    )
    if run.voltages and not data.knows_voltage:
        print(
            "the voltage is ignored: it was not recorded during the whole flight\n",
            file=sys.stderr,
        )
    found = fit(data, given=mpc)
    # In lockstep a command takes no time.
    lockstep = bag.parameters_of(MpcConfig).get("lockstep", False)
    age = float("nan") if lockstep else data.command_age
    table = identification_table(found, mpc, command_age=age, file=options.out)
    print(table, file=sys.stderr)
    text = parameter_file(found, mpc, bag=run.bag, keep=options.keep, bridge=bridge)
    if options.out is None:
        print(text, end="")
    else:
        write_new("--out", options.out, text, overwrite=options.overwrite)
        print(f"\nparameters  {options.out}", file=sys.stderr)
    if options.plot is not None:
        try:
            figure = write_fit_figure(found, options.plot)
            print(f"plot        {figure}", file=sys.stderr)
        except OSError as error:
            raise UserError(
                f"--plot: {options.plot} cannot be written: {error.strerror}"
            ) from error
    return 0


def _bridge(options: argparse.Namespace, run: RecordedRun) -> Mapping[str, Any]:
    """Return the recorded parameters of the bridge, with what ``--config`` says over them."""
    from quad_mpc_ros.analysis.identification.measurements import recorded_bridge
    from quad_mpc_ros.commands.run_configuration import SCHEMA
    from quad_mpc_ros.configuration import files
    from quad_mpc_ros.ros.bridges.config import BridgeConfig

    schema = {**SCHEMA, "bridge": BridgeConfig}
    given = files.collected(options.config, [], schema=schema)["bridge"]
    BridgeConfig.build(given)
    return {**recorded_bridge(run.parameters), **given}
