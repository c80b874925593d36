"""``quad_mpc simulate``: the closed loop in one process, without ROS, faster than real time."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from quad_mpc_ros.bags import BagWriter, QosProfile, RosbagsMessages
from quad_mpc_ros.bags.run_parameters import write_parameters
from quad_mpc_ros.commands.progress import Progress
from quad_mpc_ros.commands.results import finish
from quad_mpc_ros.commands.run_options import SCHEMA, RunConfig, resolve
from quad_mpc_ros.control.controller import Tick
from quad_mpc_ros.references.server import ReferenceServer
from quad_mpc_ros.ros import conversions
from quad_mpc_ros.ros.topics import (
    COMMAND,
    ODOMETRY,
    PREDICTED_PATH,
    REFERENCE,
    REFERENCE_PATH,
    STATS,
    Topic,
)
from quad_mpc_ros.simulation.closed_loop import SIMULATION_START_NS, LoopStep, fly
from quad_mpc_ros.simulation.plants import make_plant

_TOPICS = (ODOMETRY, REFERENCE, COMMAND, PREDICTED_PATH, REFERENCE_PATH, STATS)


def simulate(options: argparse.Namespace) -> int:
    """Fly, record and evaluate; return the exit code."""
    config = resolve(options, lockstep=True)
    make_plant(config.simulator)  # one that is not installed is told before a bag is begun
    progress = Progress(config.simulator.duration)
    print(f"simulating the {config.reference.trajectory} into {config.out}", file=sys.stderr)
    started = time.monotonic()
    with RunRecorder(config) as recorder:
        recorder.reference_path()
        for step in fly(
            mpc=config.mpc,
            simulator=config.simulator,
            reference=config.reference,
            trajectory=config.trajectory,
        ):
            recorder.step(step)
            if progress.due:
                progress.show(
                    (step.odometry.stamp_ns - SIMULATION_START_NS) * 1e-9,
                    float(np.linalg.norm(step.window.p_WB[0] - step.odometry.p_WB)),
                )
    wall_seconds = time.monotonic() - started
    progress.close()
    return finish(config.out, wall_seconds=wall_seconds)


class RunRecorder:
    """Writes the loop's values as the messages that the nodes would have published."""

    def __init__(self, config: RunConfig) -> None:
        self._config = config
        self._messages = RosbagsMessages()
        self._writer = BagWriter(
            config.bag,
            compression=config.recorder.compression,  # type: ignore[arg-type]
        )
        for topic in _TOPICS:
            self._writer.add_topic(
                f"/{topic.name}", topic.type_name, qos_profiles=[_offered(topic)]
            )
        for node in SCHEMA:
            write_parameters(self._writer, node, getattr(config, node).flattened())

    def __enter__(self) -> RunRecorder:
        return self

    def __exit__(self, *_: object) -> None:
        self._writer.close()

    def reference_path(self) -> None:
        """Write the whole reference, as the reference node latches it."""
        whole = ReferenceServer(self._config.reference, self._config.trajectory).whole()

        def fill(message: Any) -> None:
            conversions.fill_path(
                message,
                stamp_ns=SIMULATION_START_NS,
                frame_id=self._config.reference.frame_id,
                pose_stamps_ns=[SIMULATION_START_NS] * len(whole.p_WB),
                p_WB=whole.p_WB,
                q_WB_xyzw=whole.q_WB_xyzw,
                new=self._messages.new,
            )

        self._write(REFERENCE_PATH, SIMULATION_START_NS, fill)

    def step(self, step: LoopStep) -> None:
        """Write one odometry and what followed from it."""
        stamp_ns = step.odometry.stamp_ns
        self._write(ODOMETRY, stamp_ns, lambda m: conversions.fill_odometry(m, step.odometry))
        self._write(
            REFERENCE,
            stamp_ns,
            lambda m: conversions.fill_reference(
                m,
                step.window,
                child_frame_id=step.odometry.child_frame_id,
                new=self._messages.new,
            ),
        )
        if step.tick is not None:
            self._tick(stamp_ns, step.tick)
        self._writer.flush_if_due(time.monotonic())

    def _tick(self, stamp_ns: int, tick: Tick) -> None:
        command, plan, new = tick.command, tick.plan, self._messages.new
        # The loop answers at once in its own time; what a command took is on the wall clock.
        answered_ns = stamp_ns + round(1e3 * tick.stats.step_time_us)
        if command is not None:
            self._write(
                COMMAND,
                stamp_ns,
                lambda m: conversions.fill_command(m, command),
                publish_time_ns=answered_ns,
            )
        self._write(STATS, stamp_ns, lambda m: conversions.fill_stats(m, tick.stats, new=new))
        if plan is not None:
            self._write(
                PREDICTED_PATH,
                stamp_ns,
                lambda m: conversions.fill_plan(
                    m,
                    stamp_ns=plan.stamp_ns,
                    frame_id=self._config.mpc.odometry.frame_id,
                    step_ns=round(plan.step * 1e9),
                    p_WB=plan.p_WB,
                    R_WB=plan.R_WB,
                    new=new,
                ),
            )

    def _write(
        self,
        topic: Topic,
        stamp_ns: int,
        fill: Callable[[Any], None],
        *,
        publish_time_ns: int | None = None,
    ) -> None:
        message = self._messages.new(topic.type_name)
        fill(message)
        self._writer.write(
            f"/{topic.name}",
            self._messages.encode(topic.type_name, message),
            log_time_ns=stamp_ns,
            publish_time_ns=stamp_ns if publish_time_ns is None else publish_time_ns,
        )


def _offered(topic: Topic) -> QosProfile:
    return QosProfile(
        depth=topic.depth,
        reliability="reliable" if topic.reliable else "best_effort",
        durability="transient_local" if topic.latched else "volatile",
    )
