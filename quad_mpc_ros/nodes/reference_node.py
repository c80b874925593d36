"""The reference node: publishes windows of what is to be flown, and takes requests."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from std_srvs.srv import Trigger

from quad_mpc_ros.analysis.recorded_reference import read_recording
from quad_mpc_ros.references.catalogue import configured_trajectory, joined_trajectory
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.director import Answer
from quad_mpc_ros.references.live import LiveReference
from quad_mpc_ros.references.trajectory import TrajectorySamples
from quad_mpc_ros.ros import conversions
from quad_mpc_ros.ros.health import OK, WARN, Health, HealthReporter
from quad_mpc_ros.ros.messages import decoded, new_message
from quad_mpc_ros.ros.parameters import declare
from quad_mpc_ros.ros.spin import run
from quad_mpc_ros.ros.topics import GOAL_POSE, ODOMETRY, REFERENCE, REFERENCE_PATH, TRAJECTORY

_BODY_FRAME = "base_link"


class ReferenceNode(Node):
    """Wires the reference of a live flight to its topics and services.

    The trajectory begins with the first odometry; until then its beginning is held. With the mode
    ``on_request`` nothing is published until then, and the vehicle stands.
    """

    def __init__(self) -> None:
        super().__init__("reference", automatically_declare_parameters_from_overrides=True)
        self._config = declare(self, ReferenceConfig)
        self._live = self._prepared()
        self._newest_ns = 0
        self._request = ""
        self._health = HealthReporter(self, self._probe)
        self._reference = self._health.publisher(REFERENCE)
        self._path = self._health.publisher(REFERENCE_PATH)
        self._health.subscription(ODOMETRY, self._on_odometry, raw=True)
        self._health.subscription(GOAL_POSE, self._on_goal)
        self._health.subscription(TRAJECTORY, self._on_trajectory)
        for name, request in (
            ("takeoff", self._live.take_off),
            ("start", self._live.start),
            ("hold", self._live.hold),
            ("land", self._live.land),
        ):
            serve = functools.partial(self._serve, name, request)
            self.create_service(Trigger, f"~/{name}", serve)
        if not self._config.lockstep:
            self.create_timer(1.0 / self._config.publish_rate, self._on_timer)
        self._publish_path(self._live.whole())

    def _prepared(self) -> LiveReference:
        joined = functools.cache(
            functools.partial(joined_trajectory, self._config, read_bag=read_recording)
        )
        if self._config.mode == "on_request":
            return LiveReference(self._config, joined(), joined=joined)
        trajectory = configured_trajectory(self._config, read_bag=read_recording)
        return LiveReference(
            self._config, trajectory, joined=(lambda: trajectory) if trajectory.smooth else joined
        )

    def _on_odometry(self, data: bytes) -> None:
        if not self._config.lockstep and not self._live.needs_odometry(self._now_ns()):
            return  # not decoded: in real time most of them do not matter
        odometry = conversions.odometry_from_message(decoded(ODOMETRY, data))
        starting = not self._live.started
        answer = self._live.observe(odometry)
        if answer is not None:
            self._tell("touchdown" if answer.accepted else "odometry", answer)
        if starting or self._config.lockstep:
            self._newest_ns = odometry.stamp_ns
            self._publish(odometry.stamp_ns)

    def _on_timer(self) -> None:
        self._publish(self._now_ns())

    def _serve(self, name: str, request: Callable[[int], Answer], _: Any, response: Any) -> Any:
        answer = self._handle(name, request)
        response.success, response.message = answer.accepted, answer.text
        return response

    def _on_goal(self, message: Any) -> None:
        frame_id, p_WB, q_WB_xyzw = conversions.pose_from_message(message)
        self._handle(
            "goal",
            lambda now_ns: self._live.go_to(
                now_ns, frame_id=frame_id, p_WB=p_WB, q_WB_xyzw=q_WB_xyzw
            ),
        )

    def _on_trajectory(self, message: Any) -> None:
        try:
            window = conversions.reference_from_message(message)
        except ValueError as error:
            self._tell("trajectory", Answer(accepted=False, text=str(error)))
            return
        self._handle("trajectory", lambda now_ns: self._live.follow(now_ns, window))

    def _handle(self, name: str, request: Callable[[int], Answer]) -> Answer:
        """Put a request to the flight, tell what became of it, draw what is flown then."""
        now_ns = self._now_ns()
        answer = request(now_ns)
        self._tell(name, answer)
        if answer.accepted:
            self._publish_path(self._live.course(now_ns))
        return answer

    def _tell(self, name: str, answer: Answer) -> None:
        """Log what became of a request and report it, but the same refusal only once."""
        before = self._request
        self._request = f"{name} {'accepted' if answer.accepted else 'refused'}: {answer.text}"
        if answer.accepted:
            self.get_logger().info(self._request)
        elif self._request != before:
            self.get_logger().warning(self._request)
        else:
            return
        self._health.report()

    def _publish(self, stamp_ns: int) -> None:
        window = self._live.window(stamp_ns)
        if window is None:
            return
        message = new_message(REFERENCE.type_name)
        conversions.fill_reference(message, window, child_frame_id=_BODY_FRAME, new=new_message)
        self._reference.publish(message)

    def _publish_path(self, samples: TrajectorySamples) -> None:
        stamp_ns = int(self.get_clock().now().nanoseconds)
        message = new_message(REFERENCE_PATH.type_name)
        conversions.fill_path(
            message,
            stamp_ns=stamp_ns,
            frame_id=self._config.frame_id,
            pose_stamps_ns=[stamp_ns] * len(samples.p_WB),
            p_WB=samples.p_WB,
            q_WB_xyzw=samples.q_WB_xyzw,
            new=new_message,
        )
        self._path.publish(message)

    def _now_ns(self) -> int:
        """Return the time of the flight: in lockstep that of the newest odometry."""
        return (
            self._newest_ns if self._config.lockstep else int(self.get_clock().now().nanoseconds)
        )

    def _probe(self) -> Health:
        if self._live.started:
            text, level = "flying", OK
        elif self._config.mode == "at_once":
            text, level = "waiting for odometry, holding the start", OK
        else:
            text, level = "waiting for odometry", WARN
        return Health(
            level=level,
            text=text,
            values=[
                ("trajectory", self._config.trajectory),
                ("mode", self._live.mode(self._now_ns())),
                ("request", self._request),
            ],
        )


def main(args: list[str] | None = None) -> None:
    """Run the node: ``ros2 run quad_mpc_ros reference_node``."""
    sys.exit(run(ReferenceNode, args))


if __name__ == "__main__":
    main()
