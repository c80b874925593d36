"""What the commands on a recording have in common: options, the bag, its topics and parameters."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from quad_mpc_ros.commands.run_options import add_config, add_set

if TYPE_CHECKING:
    from quad_mpc_ros.configuration import Configuration
    from quad_mpc_ros.recordings.recording import Recording
    from quad_mpc_ros.recordings.run import RecordedRun, TopicNames

WHICH_BAG = "bag directory, .mcap file, or folder of a run with bag/ in it"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the bag, how to read it, and the configuration that is put over the recorded one."""
    parser.add_argument("bag", type=Path, metavar="BAG", help=WHICH_BAG)
    add_config(parser, "over the recorded parameters")
    add_set(parser, "set one parameter, for example mpc.mass=0.5")
    for option, meaning in (
        ("--odom-topic", "nav_msgs/Odometry (default: the topic that ends in /odom)"),
        ("--pose-topic", "geometry_msgs/PoseStamped, with --twist-topic in place of odometry"),
        (
            "--twist-topic",
            "geometry_msgs/TwistStamped that belongs to --pose-topic; if in the world frame, with "
            "--set mpc.odometry.twist_frame=world",
        ),
        (
            "--command-topic",
            "geometry_msgs/TwistStamped, throttle in linear.z, body rates in angular (default: "
            "the topic that ends in /command)",
        ),
    ):
        parser.add_argument(option, default="", metavar="NAME", help=meaning)


def opened(path: Path) -> Recording:
    """Open a recording, and warn of one that was not ended properly.

    Raises :class:`BagError`.
    """
    from quad_mpc_ros.recordings.recording import Recording

    bag = Recording(path)
    if bag.warning:
        print(f"warning: {bag.warning}", file=sys.stderr)
    return bag


def topic_names(options: argparse.Namespace) -> TopicNames:
    """Return the topics that were named. Raises :class:`UserError` for those that exclude."""
    from quad_mpc_ros.recordings.run import TopicNames

    return TopicNames(
        odometry=options.odom_topic,
        pose=options.pose_topic,
        twist=options.twist_topic,
        reference=getattr(options, "reference_topic", ""),
        command=options.command_topic,
        battery=getattr(options, "battery_topic", ""),
    )


def configuration(
    options: argparse.Namespace, run: RecordedRun, *, assignments: tuple[str, ...] = ()
) -> dict[str, Configuration]:
    """Return the recorded parameters of every node with what was given over them.

    ``assignments`` come after the files and before ``--set``. Raises :class:`UserError` for
    anything that cannot be used.
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
