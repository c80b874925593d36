# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The visualisation node: markers of fence, gates and corridor; the pose on /tf."""

from __future__ import annotations

import contextlib
import functools
import sys
from typing import Any

from rclpy.publisher import Publisher

from quad_mpc_ros.configuration import optional_part
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.control.safety.validation import odometry_fault
from quad_mpc_ros.messages import conversions, markers, topics
from quad_mpc_ros.messages.corridor import corridor_edges, corridor_from_message
from quad_mpc_ros.messages.diagnostics import OK, WARN
from quad_mpc_ros.messages.markers import VisualisationConfig
from quad_mpc_ros.ros.clocks import create_steady_timer
from quad_mpc_ros.ros.health import Health, ReportingNode
from quad_mpc_ros.ros.messages import message_class, new_message
from quad_mpc_ros.ros.spin import run


class VisualisationNode(ReportingNode[VisualisationConfig]):
    """Publishes markers and the transform of the newest odometry periodically.

    Viewers draw odometry and paths from their own messages.
    """

    def __init__(self) -> None:
        super().__init__("visualisation", VisualisationConfig)
        period = 1.0 / self.config.publish_rate
        self._odometry: OdometrySample | None = None
        self._plan: Any = None
        self._has_new_odometry = False
        self._corridor: Any = None
        self._gates = []
        if self.config.gates:
            read = optional_part("read_course", needed_by=f"{self.config.owner}.gates")
            self._gates = [gate.corners() for gate in read(self.config.gates).once().values()]

        self._markers = self.health.publisher(topics.MARKERS)
        self._transforms = self._transform_publisher()
        self.health.subscription(topics.ODOMETRY, self._on_odometry)
        self.health.subscription(topics.PREDICTED_PATH, self._on_plan, expected=False)
        self.health.subscription(topics.CORRIDOR, self._on_corridor, expected=False)
        create_steady_timer(self, period, self._show)

    def _transform_publisher(self) -> Publisher | None:
        if not self.config.broadcast_tf:
            return None
        try:
            message_class(topics.TF.type_name)
        except ImportError:
            self.get_logger().info("tf2_msgs is not installed: no transform is broadcast")
            return None
        return self.health.publisher(topics.TF)

    def _on_odometry(self, message: Any) -> None:
        odometry = conversions.odometry_from_message(message)
        fault = odometry_fault(odometry, frame_id=odometry.frame_id)
        if fault is not None:
            return  # the controller warns about it
        self._odometry, self._has_new_odometry = odometry, True

    def _on_plan(self, message: Any) -> None:
        self._plan = message

    def _on_corridor(self, message: Any) -> None:
        with contextlib.suppress(ValueError):  # of another sender
            self._corridor = corridor_from_message(message)

    def _show(self) -> None:
        if self._odometry is None or not self._has_new_odometry:
            return
        self._has_new_odometry = False
        if drawn := self._drawn(self._odometry):
            message = new_message(topics.MARKERS.type_name)
            message.markers = drawn
            self._markers.publish(message)
        if self._transforms is not None:
            transform = new_message(topics.TF.type_name)
            conversions.fill_transform(transform, self._odometry, new=new_message)
            self._transforms.publish(transform)

    def _drawn(self, odometry: OdometrySample) -> list[Any]:
        fence, drawn = self.config.fence, []
        if fence.is_closed:
            drawn.append(markers.fence_marker(odometry, fence, new=new_message))
        if self._gates:
            drawn.append(markers.gates_marker(odometry, self._gates, new=new_message))
        if self._plan is not None and self._corridor is not None:
            p_WB = conversions.positions_from_path(self._plan)
            if len(p_WB):
                edges = corridor_edges(self._corridor, p_WB).reshape(-1, 3)
                drawn.append(
                    markers.line_marker(markers.CORRIDOR, odometry, edges, new=new_message)
                )
            self._plan = self._corridor = None  # published once: viewers drop expired markers
        return drawn

    def report(self) -> Health:
        """Return the health: whether odometry was received."""
        if self._odometry is None:
            return Health(level=WARN, text="waiting for odometry")
        return Health(level=OK, text="showing")


main = functools.partial(run, VisualisationNode)

if __name__ == "__main__":
    sys.exit(main())
