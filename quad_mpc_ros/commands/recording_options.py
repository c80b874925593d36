"""The options of the commands that work on a recording."""

from __future__ import annotations

import argparse
from pathlib import Path

from quad_mpc_ros.commands.vehicle_options import add_vehicle_file_options


def add_identify_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``identify``."""
    _add_recording_options(parser)
    add_vehicle_file_options(parser)
    parser.add_argument(
        "--plot", type=Path, metavar="PNG", help="draw measured and fitted rates and thrust"
    )
    parser.add_argument(
        "--overwrite", action="store_true", help="let --out and --plot replace existing files"
    )


def add_resolve_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``resolve``."""
    _add_recording_options(parser)
    parser.add_argument(
        "--reference-topic",
        default="",
        metavar="NAME",
        help="trajectory_msgs/MultiDOFJointTrajectory (default: the topic that ends in "
        "/reference)",
    )
    parser.add_argument(
        "--reference",
        metavar="NAME",
        help="trajectory to follow from the first odometry on, instead of the recorded reference: "
        "square, hover, lemniscate",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder for bag, summary.json and figures; must not hold any "
        "(default: runs/<date-time>_resolved)",
    )


def _add_recording_options(parser: argparse.ArgumentParser) -> None:
    """Add the bag, how to read it, and the configuration that is put over the recorded one."""
    parser.add_argument(
        "bag",
        type=Path,
        metavar="BAG",
        help="bag directory, .mcap file, or folder of a run with bag/ in it",
    )
    parser.add_argument(
        "--config",
        action="append",
        default=[],
        metavar="FILE",
        help="ROS parameter file or preset over the recorded parameters; may be repeated, later "
        "ones win",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NODE.PARAM=VALUE",
        dest="assignments",
        help="set one parameter, for example mpc.mass=0.5; may be repeated",
    )
    for option, meaning in (
        ("--odom-topic", "nav_msgs/Odometry (default: the topic that ends in /odom)"),
        ("--pose-topic", "geometry_msgs/PoseStamped, with --twist-topic in place of odometry"),
        ("--twist-topic", "geometry_msgs/TwistStamped that belongs to --pose-topic"),
        (
            "--command-topic",
            "geometry_msgs/TwistStamped, throttle in linear.z, body rates in angular (default: "
            "the topic that ends in /command)",
        ),
    ):
        parser.add_argument(option, default="", metavar="NAME", help=meaning)
    parser.add_argument(
        "--twist-frame",
        choices=("child", "world"),
        help="frame of the twist: child (REP-103, body) or world (default: "
        "mpc.odometry.twist_frame)",
    )
