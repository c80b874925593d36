# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The controller of a vehicle in one process: MPC, reference and an optional bridge.

    stack_node --ros-args --params-file vehicle.yaml                 # mpc and reference
    stack_node --reference false --bridge px4                        # mpc and bridge
    stack_node --bridge px4 --ros-args --params-file vehicle.yaml

The nodes have the same names, parameters, topics and services as separate processes. Each node has
its own thread, so planning does not delay the MPC. When one node ends, all end.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable

from rclpy.node import Node

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.configuration.argument_parser import ArgumentParser
from quad_mpc_ros.ros.bridges.node import BridgeNode
from quad_mpc_ros.ros.bridges.registry import load_bridge
from quad_mpc_ros.ros.nodes.mpc_node import MpcNode
from quad_mpc_ros.ros.nodes.reference_node import ReferenceNode
from quad_mpc_ros.ros.parameter_files import read_arguments
from quad_mpc_ros.ros.spin import EXIT_BAD_INPUT, run

_NO_BRIDGE = "none"


def main(args: list[str] | None = None) -> int:
    """Run the nodes until one of them ends; return the exit code."""
    parser = ArgumentParser(prog="stack_node", description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--bridge", default=_NO_BRIDGE, metavar="NAME", help="also run a bridge, such as px4"
    )
    parser.add_argument(
        "--reference", default="true", choices=["true", "false"], help="also run the reference"
    )
    others: list[Callable[[], Node]] = []
    try:
        _, own = read_arguments(sys.argv if args is None else args)
        options = parser.parse_args(own[1:])
        if options.reference == "true":
            others.append(ReferenceNode)
        if options.bridge != _NO_BRIDGE:
            others.append(functools.partial(BridgeNode, load_bridge(options.bridge)))
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    return run(MpcNode, args, others=others)


if __name__ == "__main__":
    sys.exit(main())
