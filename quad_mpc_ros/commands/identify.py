# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc identify``: estimate lags, delay, thrust and drag from a recorded flight."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from quad_mpc_ros.commands import recording
from quad_mpc_ros.commands.output import check_writable, results_in, write_new

if TYPE_CHECKING:
    from quad_mpc_ros.recordings.run import RecordedRun


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the bag, the outputs and the value to keep."""
    parser.description = (
        "Estimate lags of body rates and thrust, input delay, thrust per mass and drag from "
        "commands and odometry of a flight, and with a recorded battery the effect of the "
        "voltage on the thrust. Print the vehicle file (ROS parameters below /**) on standard "
        "output, and a table of estimates with 95 % confidence intervals on stderr."
    )
    recording.add_options(parser)
    parser.add_argument(
        "--battery-topic",
        default="",
        metavar="NAME",
        help="sensor_msgs/BatteryState, or BatteryStatus of px4_msgs or rosflight_msgs (default: "
        "the only one in the bag)",
    )
    parser.add_argument(
        "--keep",
        choices=("mass", "curve"),
        default="mass",
        help="configured value to keep, as only the thrust per mass is observable: mass scales "
        "the thrust curve, curve changes the mass (default: mass)",
    )
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="write the vehicle file instead of printing it"
    )
    parser.add_argument(
        "--plot", type=Path, metavar="PNG", help="draw measured and fitted rates and thrust"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace existing files")


def run(options: argparse.Namespace) -> int:
    """Fit, print the table on standard error, write; return the exit code."""
    from quad_mpc_ros.analysis.identification.figure import write_fit_figure
    from quad_mpc_ros.analysis.identification.fit import fit
    from quad_mpc_ros.analysis.identification.measurements import RECORDED, measurements_of
    from quad_mpc_ros.analysis.identification.report import identification_table, parameter_file
    from quad_mpc_ros.control.config import MpcConfig
    from quad_mpc_ros.recordings.recording import Recording

    for name, path in (("--out", options.out), ("--plot", options.plot)):
        check_writable(name, path, overwrite=options.overwrite)
    bag = Recording(options.bag)
    run = bag.run(recording.topic_names(options), topics=RECORDED)
    mpc = cast("MpcConfig", recording.configuration(options, run)["mpc"])
    bridge = _bridge(options, run)
    data = measurements_of(
        run,
        vehicle=mpc.vehicle(),
        twist_frame=mpc.odometry.twist_frame,
        bridge=bridge,
    )
    if run.voltages and not data.knows_voltage:
        print(
            "the voltage is ignored: it was not recorded during the whole flight\n",
            file=sys.stderr,
        )
    found = fit(data, given=mpc)
    # In lockstep the computation takes no time.
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
        with results_in(options.plot):
            write_fit_figure(found, options.plot)
        print(f"plot        {options.plot}", file=sys.stderr)
    return 0


def _bridge(options: argparse.Namespace, run: RecordedRun) -> Mapping[str, Any]:
    """Return the recorded parameters of the bridge, overridden by ``--config``."""
    from quad_mpc_ros.analysis.identification.measurements import recorded_bridge
    from quad_mpc_ros.commands.run_configuration import SCHEMA
    from quad_mpc_ros.configuration import files
    from quad_mpc_ros.ros.bridges.config import BridgeConfig

    schema = {**SCHEMA, "bridge": BridgeConfig}
    given = files.collected(options.config, schema=schema)["bridge"]
    BridgeConfig.build(given)
    return {**recorded_bridge(run.parameters), **given}
