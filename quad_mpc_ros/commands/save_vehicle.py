"""``quad_mpc save-vehicle``: what a flying controller has learned, as a parameter file."""

from __future__ import annotations

import argparse
import math
import sys
from datetime import UTC, datetime

from quad_mpc_ros.commands.new_file import check_writable, write_new
from quad_mpc_ros.commands.processes import require_ros
from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.identification import learned, learned_file


def save_vehicle(options: argparse.Namespace) -> int:
    """Watch, tell, write; return the exit code."""
    check_writable("--out", options.out, overwrite=options.overwrite)
    if not (math.isfinite(options.duration) and options.duration > 0.0):
        raise UserError(f"--duration: given {options.duration}, expected a number > 0")
    require_ros("save-vehicle", instead="; 'identify' finds the vehicle in a recorded flight")
    from quad_mpc_ros.commands.running_mpc import RunningMpc

    with RunningMpc(options.node) as mpc:
        config = mpc.configuration()
        ticks = mpc.watch(options.duration)
    found = learned(ticks, config)
    now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    head = (
        f"Learned in flight by {mpc.name}, {now}, {found.ticks} ticks; +- is how far the estimate "
        "wandered."
    )
    text = learned_file(found, config, head=head, keep=options.keep)
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
