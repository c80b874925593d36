"""What commands that work on a recording have in common: its topics, its parameters."""

from __future__ import annotations

import argparse
from pathlib import Path

from quad_mpc_ros.commands.run_options import SCHEMA
from quad_mpc_ros.configuration import Configuration, files
from quad_mpc_ros.recordings.bag_metadata import METADATA_FILE
from quad_mpc_ros.recordings.parameters import recorded_parameters
from quad_mpc_ros.recordings.recorded_run import RecordedRun, TopicNames


def bag_of(given: Path) -> Path:
    """Return the bag of what was given, which may be the folder of a run."""
    inside = given / "bag"
    return inside if inside.is_dir() and not (given / METADATA_FILE).exists() else given


def topic_names(options: argparse.Namespace) -> TopicNames:
    """Return the topics that were named. Raises :class:`UserError` for those that exclude."""
    return TopicNames(
        odometry=options.odom_topic,
        pose=options.pose_topic,
        twist=options.twist_topic,
        reference=getattr(options, "reference_topic", ""),
        command=options.command_topic,
    )


def recorded_configuration(
    options: argparse.Namespace, run: RecordedRun, *, assignments: tuple[str, ...] = ()
) -> dict[str, Configuration]:
    """Return the recorded parameters of every node with what was given over them.

    ``assignments`` come after the files and before ``--set``. Raises :class:`UserError` for
    anything that cannot be used.
    """
    made = [*assignments]
    if options.twist_frame is not None:
        made.append(f"mpc.odometry.twist_frame={options.twist_frame}")
    return files.load(
        options.config,
        [*made, *options.assignments],
        schema=SCHEMA,
        base={node: recorded_parameters(run.parameters, kind) for node, kind in SCHEMA.items()},
    )
