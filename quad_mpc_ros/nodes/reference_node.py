"""The reference node: publishes the configured trajectory as windows ahead of now."""

from __future__ import annotations

import sys

from rclpy.node import Node

from quad_mpc_ros.analysis.recorded_reference import read_recording
from quad_mpc_ros.references.catalogue import configured_trajectory
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.server import ReferenceServer
from quad_mpc_ros.ros import conversions
from quad_mpc_ros.ros.health import OK, Health, HealthReporter
from quad_mpc_ros.ros.messages import decoded, new_message
from quad_mpc_ros.ros.parameters import declare
from quad_mpc_ros.ros.spin import run
from quad_mpc_ros.ros.topics import ODOMETRY, REFERENCE, REFERENCE_PATH

_BODY_FRAME = "base_link"


class ReferenceNode(Node):
    """Wires the reference server to its topics.

    The trajectory begins with the first odometry; until then its beginning is held.
    """

    def __init__(self) -> None:
        super().__init__("reference", automatically_declare_parameters_from_overrides=True)
        self._config = declare(self, ReferenceConfig)
        trajectory = configured_trajectory(self._config, read_bag=read_recording)
        self._server = ReferenceServer(self._config, trajectory)
        self._health = HealthReporter(self, self._probe)
        self._reference = self._health.publisher(REFERENCE)
        self._path = self._health.publisher(REFERENCE_PATH)
        self._health.subscription(ODOMETRY, self._on_odometry, raw=True)
        if not self._config.lockstep:
            self.create_timer(1.0 / self._config.publish_rate, self._on_timer)
        self._publish_whole()

    def _on_odometry(self, data: bytes) -> None:
        if self._server.started and not self._config.lockstep:
            return  # not decoded: in real time only the first one matters
        odometry = decoded(ODOMETRY, data)
        stamp_ns = conversions.nanoseconds(odometry.header.stamp)
        if not self._server.started:
            self._server.start(stamp_ns)
        self._publish(stamp_ns)

    def _on_timer(self) -> None:
        self._publish(int(self.get_clock().now().nanoseconds))

    def _publish(self, stamp_ns: int) -> None:
        message = new_message(REFERENCE.type_name)
        conversions.fill_reference(
            message,
            self._server.window(stamp_ns),
            child_frame_id=_BODY_FRAME,
            new=new_message,
        )
        self._reference.publish(message)

    def _publish_whole(self) -> None:
        whole = self._server.whole()
        stamp_ns = int(self.get_clock().now().nanoseconds)
        message = new_message(REFERENCE_PATH.type_name)
        conversions.fill_path(
            message,
            stamp_ns=stamp_ns,
            frame_id=self._config.frame_id,
            pose_stamps_ns=[stamp_ns] * len(whole.p_WB),
            p_WB=whole.p_WB,
            q_WB_xyzw=whole.q_WB_xyzw,
            new=new_message,
        )
        self._path.publish(message)

    def _probe(self) -> Health:
        text = "flying" if self._server.started else "waiting for odometry, holding the start"
        return Health(level=OK, text=text, values=[("trajectory", self._config.trajectory)])


def main(args: list[str] | None = None) -> None:
    """Run the node: ``ros2 run quad_mpc_ros reference_node``."""
    sys.exit(run(ReferenceNode, args))


if __name__ == "__main__":
    main()
