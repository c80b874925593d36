# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``quad_mpc resolve``: recompute the commands of a recorded flight."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, cast

from quad_mpc_ros.commands import recording
from quad_mpc_ros.commands.output import create_out, prepared_out, results_in, write_json
from quad_mpc_ros.commands.run_options import add_out
from quad_mpc_ros.configuration import BagError

if TYPE_CHECKING:
    from quad_mpc_ros.analysis.figures.command_comparison import CommandComparison
    from quad_mpc_ros.control.config import MpcConfig
    from quad_mpc_ros.recordings.replay.resolution import Resolved, WindowSource
    from quad_mpc_ros.recordings.run import RecordedRun
    from quad_mpc_ros.references.config import ReferenceConfig

_MAX_WARNINGS = 5


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the bag, the reference and the output."""
    parser.description = (
        "Feed the recorded odometry and reference to the controller, without ROS, and compare "
        "its commands with the recorded ones. With the recorded parameters (default) the "
        "commands are identical; override parameters with --config and --set. Writes DIR/bag, "
        "DIR/summary.json and DIR/figures/commands.png."
    )
    recording.add_options(parser)
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
        help="trajectory that starts at the first odometry, instead of the recorded reference; "
        "'quad_mpc simulate --help' lists the names",
    )
    add_out(parser, "bag, summary.json and figures; must not contain any yet", "resolved")


def run(options: argparse.Namespace) -> int:
    """Recompute, record and compare; return the exit code."""
    from quad_mpc_ros.messages.topics import REFERENCE
    from quad_mpc_ros.recordings.recording import Recording

    run = Recording(options.bag).run(recording.topic_names(options))
    config = recording.configuration(options, run, assignments=_adopted(options, run))
    mpc = cast("MpcConfig", config["mpc"])
    windows = None
    if options.reference is not None:
        from quad_mpc_ros.references.server import ReferenceServer

        server = ReferenceServer(cast("ReferenceConfig", config["reference"]))
        server.start(run.odometries[0].value.stamp_ns)
        windows = server.window
    elif not run.windows:
        raise BagError(
            f"{run.bag}: contains no reference: use --reference NAME, or --reference-topic with "
            f"a topic of type {REFERENCE.type_name}"
        )
    out = prepared_out(options.out or create_out("resolved"))
    print(f"resolving {run.bag} into {out}", file=sys.stderr)
    steps = _recorded(out / "bag", run, mpc, windows)
    if not any(step.tick is not None and step.tick.command is not None for step in steps):
        print("warning: the controller returned no command", file=sys.stderr)
    _write_results(out, run, _compared(run, steps), mpc)
    return 0


def _adopted(options: argparse.Namespace, run: RecordedRun) -> tuple[str, ...]:
    """Return assignments from the bag and the options, which ``--set`` overrides."""
    from quad_mpc_ros.control.config import MpcConfig
    from quad_mpc_ros.recordings.parameters import recorded_parameters

    made = []
    if not recorded_parameters(run.parameters, MpcConfig):
        frame = run.odometries[0].value.frame_id
        made += [f"mpc.odometry.frame_id={frame}", f"reference.frame_id={frame}"]
        print(
            f"the bag has no parameters of mpc: using defaults and the odometry's frame {frame!r}",
            file=sys.stderr,
        )
    if options.reference is not None:
        made.append(f"reference.trajectory={options.reference}")
    return tuple(made)


def _recorded(
    bag: Path, run: RecordedRun, mpc: MpcConfig, windows: WindowSource | None
) -> list[Resolved]:
    """Feed the flight to the controller, and record its inputs and outputs in a bag."""
    from quad_mpc_ros.commands.run_recorder import RunRecorder
    from quad_mpc_ros.messages import cdr, topics
    from quad_mpc_ros.recordings.replay.resolution import resolve

    others = {
        node: values
        for node, values in run.parameters.items()
        if node.rsplit("/", 1)[-1] != mpc.owner
    }
    steps = []
    with RunRecorder(
        bag,
        parameters={**others, mpc.owner: mpc.flattened()},
        frame_id=mpc.odometry.frame_id,
    ) as recorder:
        for sample in run.imu:
            data = cdr.written_imu(sample.value)
            recorder.write(topics.IMU, data, time_ns=sample.log_time_ns)
        for sent in run.commands:
            recorder.write(
                topics.RECORDED_COMMAND,
                cdr.written_command(sent.value),
                time_ns=sent.log_time_ns,
                publish_time_ns=sent.publish_time_ns,
            )
        window = None
        for step in resolve(run, mpc, windows=windows, warn=_print_few_warnings()):
            steps.append(step)
            if step.odometry is not None:
                data = cdr.written_odometry(step.odometry.value)
                recorder.write(topics.ODOMETRY, data, time_ns=step.log_time_ns)
            if step.window is not None and step.window is not window:
                window = step.window
                data = cdr.written_reference(window, child_frame_id="base_link")
                recorder.write(topics.REFERENCE, data, time_ns=step.log_time_ns)
            if step.tick is not None:
                recorder.tick(step.tick, time_ns=step.log_time_ns)
            recorder.flush_if_due()
    return steps


def _print_few_warnings() -> Callable[[str], None]:
    """Return a callback that prints each warning of the controller once, up to a maximum."""
    printed: set[str] = set()

    def warn(text: str) -> None:
        if text not in printed and len(printed) < _MAX_WARNINGS:
            printed.add(text)
            print(f"warning: {text}", file=sys.stderr)

    return warn


def _compared(run: RecordedRun, steps: Iterable[Resolved]) -> CommandComparison:
    """Compare up to the last odometry; afterwards only the watchdog sends commands."""
    from quad_mpc_ros.analysis.figures.command_comparison import compare_commands

    end_ns = max(odometry.value.stamp_ns for odometry in run.odometries)
    ticks = [step.tick for step in steps if step.tick is not None]
    return compare_commands(
        [sent.value for sent in run.commands if sent.value.stamp_ns <= end_ns],
        [tick.command for tick in ticks if tick.command is not None],
    )


def _write_results(
    out: Path, run: RecordedRun, comparison: CommandComparison, mpc: MpcConfig
) -> None:
    from quad_mpc_ros.analysis.figures.command_comparison import (
        comparison_table,
        write_command_comparison,
    )

    summary = {
        "bag": str(run.bag),
        "odometries": len(run.odometries),
        **comparison.summary(),
        "config": {mpc.owner: mpc.flattened()},
    }
    with results_in(out):
        write_json(out / "summary.json", summary)
        figure = write_command_comparison(comparison, out / "figures" / "commands.png")
    print(comparison_table(comparison))
    print(f"\nbag      {out / 'bag'}\nsummary  {out / 'summary.json'}\nfigure   {figure}")
