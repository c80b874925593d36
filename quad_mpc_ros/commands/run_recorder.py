"""Recording of a simulated or resolved run without ROS, with the messages of the nodes."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from quad_mpc_ros.control.model.samples import (
    CommandSample,
    ImuSample,
    OdometrySample,
    ReferenceWindow,
)
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
        self._write(topics.REFERENCE_PATH, stamp_ns, path)

    def odometry(self, odometry: OdometrySample, *, time_ns: int) -> None:
        """Write an odometry."""
        self._write(topics.ODOMETRY, time_ns, cdr.written_odometry(odometry))

    def imu(self, sample: ImuSample, *, time_ns: int) -> None:
        """Write an accelerometer sample."""
        self._write(topics.IMU, time_ns, cdr.written_imu(sample))

    def battery(self, voltage: float, *, time_ns: int) -> None:
        """Write the voltage of a battery [V]."""
        self._write(topics.BATTERY, time_ns, cdr.written_battery(voltage, stamp_ns=time_ns))

    def reference(self, window: ReferenceWindow, *, child_frame_id: str, time_ns: int) -> None:
        """Write a window of the reference."""
        data = cdr.written_reference(window, child_frame_id=child_frame_id)
        self._write(topics.REFERENCE, time_ns, data)

    def command(
        self, command: CommandSample, *, topic: Topic, time_ns: int, answered_ns: int
    ) -> None:
        """Write a command with its log time and its publish time, ``answered_ns``."""
        self._write(topic, time_ns, cdr.written_command(command), publish_time_ns=answered_ns)

    def tick(self, tick: Tick, *, time_ns: int) -> None:
        """Write the command, the statistics and the plan of a tick."""
        command, plan = tick.command, tick.plan
        if command is not None:
            # Simulated time stands still during a step, so its duration is added here.
            answered_ns = time_ns + round(1e3 * tick.stats.step_time_us)
            self.command(command, topic=topics.COMMAND, time_ns=time_ns, answered_ns=answered_ns)
        self._write(topics.STATS, time_ns, diagnostics.written_stats(tick.stats))
        if plan is not None:
            data = conversions.written_plan(plan, frame_id=self._frame_id)
            self._write(topics.PREDICTED_PATH, time_ns, data)
            if tick.guided is not None:
                data = written_corridor(
                    tick.guided.corridor, stamp_ns=plan.stamp_ns, frame_id=self._frame_id
                )
                self._write(topics.CORRIDOR, time_ns, data)

    def flush_if_due(self) -> None:
        """Flush the bag periodically."""
        self._writer.flush_if_due(time.monotonic())

    def _write(
        self, topic: Topic, time_ns: int, data: bytes, *, publish_time_ns: int | None = None
    ) -> None:
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
