# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The recorder node: records raw serialized messages into a rosbag2 directory."""

from __future__ import annotations

import functools
import sys
import time
from collections.abc import Callable

from quad_mpc_ros.messages.diagnostics import ERROR, OK, PEERS_KEY, WARN
from quad_mpc_ros.recordings.config import RecorderConfig
from quad_mpc_ros.ros.health import Health
from quad_mpc_ros.ros.lifecycle import ManagedNode
from quad_mpc_ros.ros.nodes.recorder import Recorder
from quad_mpc_ros.ros.preflight.own import bag_place, free_bytes
from quad_mpc_ros.ros.spin import run, stop

_POLL_PERIOD = 0.1
# Time for messages that wait at the end: of publishers that go on, and of others [s].
_LIVE_DRAIN_TIME, _DRAIN_TIME = 0.5, 5.0
# No message waits after so many callbacks and so long [s] without a message.
_CALLBACKS, _QUIET_TIME = 5, 0.3
_LOST_TEXT = "were lost in transit: this machine is too busy, record fewer topics"


class RecorderNode(ManagedNode[RecorderConfig]):
    """Subscribes to the configured topics and writes their messages.

    The active node records; the inactive node keeps the bag open for the next activation. The
    cleanup ends the bag. Nothing is written before the first activation.
    """

    _recorder: Recorder

    def __init__(self) -> None:
        super().__init__("recorder", RecorderConfig)
        self.start()

    def configure(self, config: RecorderConfig) -> None:
        """Prepare a new recording."""
        self._recorder = Recorder(self, config, on_fault=self._on_fault)
        self._place = bag_place(config)
        self._lost_logged = 0
        # One timer: a wake-up costs more than the work.
        self.managed_timer(_POLL_PERIOD, self._on_timer)

    def activate(self) -> None:
        """Start recording."""
        directory = self._recorder.resume()
        self.get_logger().info(f"recording to {directory}")

    def deactivate(self) -> None:
        """Pause; the bag stays open."""
        self._recorder.pause()

    def cleanup(self) -> None:
        """End the bag."""
        self._recorder.close()
        self._log_lost()
        del self._recorder

    def drain(self, spin_once: Callable[[], None]) -> None:
        """Record the messages that have arrived, also those of publishers that have ended."""
        begin, begin_ns = time.monotonic(), time.time_ns()
        count, last, idle = self._recorder.message_count, begin, 0
        while self.active and (idle < _CALLBACKS or time.monotonic() - last < _QUIET_TIME):
            is_live = self._recorder.newest_ns > begin_ns
            if time.monotonic() - begin > (_LIVE_DRAIN_TIME if is_live else _DRAIN_TIME):
                break
            spin_once()
            idle += 1
            if count != self._recorder.message_count:
                count, last, idle = self._recorder.message_count, time.monotonic(), 0

    def report(self) -> Health:
        """Return the health: missing topics, lost messages, faults."""
        recorder = self._recorder
        missing, lost = recorder.missing, recorder.lost_count
        text = f"no publisher yet: {', '.join(missing)}" if missing else "recording"
        if lost:
            text = f"{lost} messages {_LOST_TEXT}"
        return Health(
            level=ERROR if recorder.fault else WARN if missing or lost else OK,
            text=recorder.fault or text,
            values=[
                *(
                    (f"{PEERS_KEY}{topic}", str(count))
                    for topic, count in recorder.publisher_counts.items()
                ),
                ("messages", str(recorder.message_count)),
                ("lost", str(lost)),
                ("free_bytes", str(free_bytes(self._place))),
                ("parameters_missing", " ".join(recorder.unanswered)),
            ],
        )

    def _on_timer(self) -> None:
        if not self.active:
            return
        more = self._recorder.poll()
        if self._log_lost() or more:
            self.health.report()

    def _log_lost(self) -> bool:
        """Log messages lost since the last call; return whether any were lost."""
        lost = self._recorder.lost_count - self._lost_logged
        self._lost_logged += lost
        if lost:
            self.get_logger().warning(f"{lost} messages {_LOST_TEXT}")
        return lost > 0

    def _on_fault(self, fault: str) -> None:
        """End a recording that cannot be written, and log the reason."""
        self.exit_code = 1
        self.get_logger().fatal(f"recording ended: {fault}")
        stop()


main = functools.partial(run, RecorderNode, message_info=True)

if __name__ == "__main__":
    sys.exit(main())
