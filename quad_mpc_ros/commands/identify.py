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
from quad_mpc_ros.configuration import ConfigurationError, UserError

if TYPE_CHECKING:
    from quad_mpc_ros.analysis.identification.measurements import VoltageMap
    from quad_mpc_ros.recordings.run import RecordedRun


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the bag, and where to write what was found."""
    parser.description = (
        "Fit the lags of body rates and thrust, the input delay, the thrust per mass, over the "
        "battery's voltage if that was recorded, and the drag to the commands and the odometry "
        "of a flight. Prints the vehicle file, ROS parameters for every node below /**, on "
        "standard output, and what was found with its 95 %% intervals on standard error."
    )
    recording.add_options(parser)
    _add_battery_options(parser)
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
    )
    from quad_mpc_ros.analysis.identification.report import identification_table, parameter_file
    from quad_mpc_ros.control.config import MpcConfig

    for name, path in (("--out", options.out), ("--plot", options.plot)):
        check_writable(name, path, overwrite=options.overwrite)
    bag = recording.opened(options.bag)
    run = bag.run(recording.topic_names(options), topics=RECORDED)
    mpc = cast("MpcConfig", recording.configuration(options, run)["mpc"])
    data = measurements_of(
        run,
        vehicle=mpc.vehicle(),
        twist_frame=mpc.odometry.twist_frame,
        voltage_map=_voltage_map(options, run),
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
    text = parameter_file(found, mpc, bag=run.bag, keep=options.keep, bridge=_bridge(options, run))
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


def _add_battery_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--battery-topic",
        default="",
        metavar="NAME",
        help="sensor_msgs/BatteryState, or BatteryStatus of px4_msgs or rosflight_msgs (default: "
        "the only one in the bag)",
    )
    parser.add_argument(
        "--battery-voltage",
        type=float,
        metavar="V",
        help="voltage at which to state the thrust (default: thrust_map.battery_voltage of a "
        "bridge whose parameters are in the bag, else the mean of the flight)",
    )
    parser.add_argument(
        "--battery-exponent",
        type=float,
        metavar="N",
        help="thrust_map.battery_exponent of the bridge in that flight, with --battery-voltage "
        "(default: 0, the bridge left the voltage out)",
    )


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


def _voltage_map(options: argparse.Namespace, run: RecordedRun) -> VoltageMap:
    """Return what the bridge made of the voltage, as given or else as recorded."""
    from quad_mpc_ros.analysis.identification.measurements import VoltageMap, recorded_voltage_map
    from quad_mpc_ros.ros.bridges.config import ThrustParameters

    if options.battery_voltage is None:
        if options.battery_exponent is not None:
            raise UserError(
                f"--battery-exponent: given {options.battery_exponent}, expected "
                "--battery-voltage as well"
            )
        return recorded_voltage_map(run.parameters)
    try:
        given = ThrustParameters(
            battery_voltage=options.battery_voltage,
            battery_exponent=options.battery_exponent or 0.0,
        )
    except ConfigurationError as error:
        name = error.name.rpartition(".")[2].replace("_", "-")
        raise error.of_option(f"--{name}") from error
    return VoltageMap(
        battery_voltage=given.battery_voltage, battery_exponent=given.battery_exponent
    )
