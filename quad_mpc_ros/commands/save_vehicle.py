"""``quad_mpc save-vehicle``: what a flying controller has learned, as a parameter file."""

from __future__ import annotations

import argparse
import sys
from datetime import UTC, datetime
from pathlib import Path

from quad_mpc_ros.commands.output import check_writable, write_new
from quad_mpc_ros.commands.processes import require_ros
from quad_mpc_ros.commands.run_options import check_duration


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add which node to watch and for how long."""
    parser.description = (
        "Watch the estimates of a running MPC node for a few seconds of flight, and print a "
        "vehicle file with them: ROS parameters below /**, of which every node reads its share, "
        "the thrust map of the bridge included. The flight goes on unchanged: the file is for "
        "the next start. Exit code 2 when the MPC does not fly or the "
        "estimates have not settled."
    )
    parser.add_argument(
        "--node",
        default="/mpc",
        metavar="NAME",
        help="full name of the running MPC node, for example /uav1/mpc (default: /mpc)",
    )
    parser.add_argument(
        "--duration",
        type=float,
        default=5.0,
        metavar="S",
        help="how long to watch what it estimates (default: 5)",
    )
    add_vehicle_file_options(parser)
    parser.add_argument(
        "--overwrite", action="store_true", help="let --out replace an existing file"
    )


def add_vehicle_file_options(parser: argparse.ArgumentParser) -> None:
    """Add where to write the file, and what it shall leave as it is."""
    parser.add_argument(
        "--keep",
        choices=("mass", "curve"),
        default="mass",
        help="what is kept of thrust per mass, of which a flight shows the quotient only: "
        "mass scales the thrust curve, curve the mass (default: mass)",
    )
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="parameter file to write, instead of printing it"
    )


def run(options: argparse.Namespace) -> int:
    """Watch, write, report; return the exit code."""
    check_writable("--out", options.out, overwrite=options.overwrite)
    check_duration(options.duration)
    require_ros("save-vehicle", instead="; 'identify' finds the vehicle in a recorded flight")
    from quad_mpc_ros.analysis.identification.learned import learned, learned_file
    from quad_mpc_ros.commands.running_mpc import RunningMpc

    with RunningMpc(options.node) as mpc:
        config, bridge = mpc.configuration(), mpc.bridge()
        ticks = mpc.watch(options.duration)
    found = learned(ticks, config)
    now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    head = (
        f"Learned in flight by {mpc.name}, {now}, {found.ticks} ticks; +- is how far the estimate "
        "wandered."
    )
    text = learned_file(found, config, head=head, keep=options.keep, bridge=bridge)
    if options.out is None:
        print(text, end="")
        return 0
    write_new("--out", options.out, text, overwrite=options.overwrite)
    scale = found.thrust_scale
    print(
        f"thrust per mass {scale.value:.3f} +- {scale.half_width:.2g} of the given\n"
        f"parameters      {options.out}",
        file=sys.stderr,
    )
    return 0
