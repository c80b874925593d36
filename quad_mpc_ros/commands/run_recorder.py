# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Recording of a simulated or resolved run without ROS, with the messages of the nodes."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from quad_mpc_ros.control.tick import Tick
from quad_mpc_ros.messages import cdr, conversions, diagnostics, topics
from quad_mpc_ros.messages.corridor import written_corridor
from quad_mpc_ros.messages.topics import Topic
from quad_mpc_ros.recordings.parameters import write_parameters
from quad_mpc_ros.recordings.qos import offered_qos
from quad_mpc_ros.recordings.writer import BagWriter
from quad_mpc_ros.references.trajectory import TrajectorySamples


class RunRecorder:
    """A bag of the inputs and outputs of a controller; times in nanoseconds."""

    def __init__(
        self,
        bag: Path,
        *,
        parameters: Mapping[str, Mapping[str, Any]],
        frame_id: str,
        compression: str = "zstd",
    ) -> None:
        """Create a bag with the parameters of nodes; topics are added with their first message.

        ``frame_id`` names the world frame. Raises :class:`BagError` if the bag exists or cannot be
        created.
        """
        self._frame_id = frame_id
        self._writer = BagWriter(bag, compression=compression)  # type: ignore[arg-type]
        self._topics: set[Topic] = set()
        for node, values in parameters.items():
            write_parameters(self._writer, node, values)

    def __enter__(self) -> RunRecorder:
        return self

    def __exit__(self, *_: object) -> None:
        self._writer.close()

    def reference_path(self, whole: TrajectorySamples, *, stamp_ns: int) -> None:
        """Write the whole reference, which the reference node publishes latched."""
        path = cdr.written_path(
            stamp_ns=stamp_ns,
            step_ns=0,
            frame_id=self._frame_id,
            p_WB=whole.p_WB,
            q_WB_xyzw=whole.q_WB_xyzw,
        )
        self.write(topics.REFERENCE_PATH, path, time_ns=stamp_ns)

    def tick(self, tick: Tick, *, time_ns: int) -> None:
        """Write the command, the statistics and the plan of a tick."""
        command, plan = tick.command, tick.plan
        if command is not None:
            # Simulated time stands still during a step, so its duration is added here.
            answered_ns = time_ns + round(1e3 * tick.stats.step_time_us)
            data = cdr.written_command(command)
            self.write(topics.COMMAND, data, time_ns=time_ns, publish_time_ns=answered_ns)
        self.write(topics.STATS, diagnostics.written_stats(tick.stats), time_ns=time_ns)
        if plan is not None:
            data = conversions.written_plan(plan, frame_id=self._frame_id)
            self.write(topics.PREDICTED_PATH, data, time_ns=time_ns)
            if tick.guided is not None:
                data = written_corridor(
                    tick.guided.corridor, stamp_ns=plan.stamp_ns, frame_id=self._frame_id
                )
                self.write(topics.CORRIDOR, data, time_ns=time_ns)

    def flush_if_due(self) -> None:
        """Flush the bag periodically."""
        self._writer.flush_if_due(time.monotonic())

    def write(
        self, topic: Topic, data: bytes, *, time_ns: int, publish_time_ns: int | None = None
    ) -> None:
        """Write a message with its log time and its publish time, by default the log time."""
        if topic not in self._topics:
            self._topics.add(topic)
            profile = offered_qos(
                depth=topic.depth, reliable=topic.reliable, latched=topic.latched
            )
            self._writer.add_topic(f"/{topic.name}", topic.type_name, qos_profiles=[profile])
        self._writer.write(
            f"/{topic.name}",
            data,
            log_time_ns=time_ns,
            publish_time_ns=time_ns if publish_time_ns is None else publish_time_ns,
        )
