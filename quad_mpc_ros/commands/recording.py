# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Options, topics and parameters of the commands that read a recording."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from quad_mpc_ros.commands.run_options import add_config, add_set

if TYPE_CHECKING:
    from quad_mpc_ros.configuration import Configuration
    from quad_mpc_ros.messages.topics import Topic
    from quad_mpc_ros.recordings.run import RecordedRun

WHICH_BAG = "bag directory, .mcap file, or folder of a run with bag/ in it"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the bag, its topics, and the configuration that overrides the recorded parameters."""
    parser.add_argument("bag", type=Path, metavar="BAG", help=WHICH_BAG)
    add_config(parser, "that overrides the recorded parameters")
    add_set(parser, "set one parameter, for example mpc.mass=0.5")
    for option, meaning in (
        (
            "--odom-topic",
            "nav_msgs/Odometry (default: the topic that ends in /odom); if its twist is in the "
            "world frame, with --set mpc.odometry.twist_frame=world",
        ),
        (
            "--command-topic",
            "geometry_msgs/TwistStamped, throttle in linear.z, body rates in angular (default: "
            "the topic that ends in /command)",
        ),
    ):
        parser.add_argument(option, default="", metavar="NAME", help=meaning)


def topic_names(options: argparse.Namespace) -> dict[Topic, str]:
    """Return the names of topics that were given."""
    from quad_mpc_ros.messages.topics import BATTERY, COMMAND, ODOMETRY, REFERENCE

    names = {
        ODOMETRY: options.odom_topic,
        REFERENCE: getattr(options, "reference_topic", ""),
        COMMAND: options.command_topic,
        BATTERY: getattr(options, "battery_topic", ""),
    }
    return {topic: name for topic, name in names.items() if name}


def configuration(
    options: argparse.Namespace, run: RecordedRun, *, assignments: tuple[str, ...] = ()
) -> dict[str, Configuration]:
    """Return the recorded parameters of every node, overridden by the options.

    ``assignments`` come after the files and before ``--set``. Raises :class:`UserError` for
    invalid options.
    """
    from quad_mpc_ros.commands.run_configuration import SCHEMA
    from quad_mpc_ros.configuration import files
    from quad_mpc_ros.recordings.parameters import recorded_parameters

    return files.load(
        options.config,
        [*assignments, *options.assignments],
        schema=SCHEMA,
        base={node: recorded_parameters(run.parameters, kind) for node, kind in SCHEMA.items()},
    )
