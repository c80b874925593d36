# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The reference node: publishes windows of the reference and handles requests."""

from __future__ import annotations

import functools
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

from std_srvs.srv import Trigger

from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.safety.validation import odometry_fault
from quad_mpc_ros.messages import cdr, conversions, topics
from quad_mpc_ros.messages.diagnostics import OK, WARN
from quad_mpc_ros.references.config import ReferenceConfig
from quad_mpc_ros.references.configured import configured_trajectory, joined_trajectory
from quad_mpc_ros.references.director import GROUND, TOO_LATE, Reply
from quad_mpc_ros.references.live import LiveReference, Published
from quad_mpc_ros.references.timeline import FlightTime, StampClock
from quad_mpc_ros.references.trajectory import TrajectorySamples
from quad_mpc_ros.references.velocity import VelocityCommand
from quad_mpc_ros.ros.clocks import SteadyTime
from quad_mpc_ros.ros.health import Health
from quad_mpc_ros.ros.lifecycle import ManagedNode
from quad_mpc_ros.ros.messages import odometry_in
from quad_mpc_ros.ros.spin import run

_BODY_FRAME = "base_link"
# A requested motion starts after a lead time for planning. If planning takes longer, it is
# repeated with a lead time that is longer by 1.5 times the planning time.
_PLANNING_LEAD_NS = 100_000_000
_VELOCITY_LEAD_NS = 20_000_000  # for a velocity, which is planned in a millisecond
_LEAD_FACTOR = 1.5
_MAX_ATTEMPTS = 3
_INACTIVE = Reply(accepted=False, text="the reference node is inactive: activate it first")


class _PublishedWindow(NamedTuple):
    """The last published window: version, offset of its stamps, time of publication [ns]."""

    version: object
    ahead_ns: int
    at_ns: int


class ReferenceNode(ManagedNode[ReferenceConfig]):
    """Connects the reference of a live flight to its topics and services.

    The trajectory starts with the first odometry; before, its first sample is published. In the
    mode ``on_request`` nothing is published before a request, and the vehicle stays on the ground.
    Until the vehicle executes commands, the reference waits at the vehicle. While the node is
    inactive, the time of the flight is stopped.

    The flight uses a steady clock. A separate thread publishes windows while the executor plans:
    when the reference changes, and otherwise every twentieth of a window's length. This thread
    accesses the reference only through :attr:`.LiveReference.published`. A thread that publishes
    or stops the time holds the lock ``_publishing``.
    """

    _config: ReferenceConfig
    _live: LiveReference

    def __init__(self) -> None:
        super().__init__("reference", ReferenceConfig)
        self._newest_ns = 0
        self._steady = SteadyTime(self.get_clock())
        self._publishing = threading.Lock()
        self.start()

    def configure(self, config: ReferenceConfig) -> None:
        """Prepare the trajectory, publishers, subscriptions and services."""
        self._config = config
        self._live = self._prepared()
        self._live.too_late = lambda start_ns: self._flight_ns() > start_ns
        self._time, self._stamps = FlightTime(), StampClock()
        self._request = ""
        self._sent: _PublishedWindow | None = None
        self._renewal_ns = round(config.renewal_period * 1e9)
        self.health.lockstep = config.lockstep
        self._reference = self.health.publisher(topics.REFERENCE)
        self._path = self.health.publisher(topics.REFERENCE_PATH)
        self.managed_subscription(topics.ODOMETRY, self._on_odometry, raw=True)
        self.managed_subscription(topics.ENGAGED, self._on_engaged, expected=False)
        self.managed_subscription(topics.LANDED, self._on_landed, expected=False)
        self.managed_subscription(topics.GROUND_STATE, self._on_ground_state, expected=False)
        self.managed_subscription(
            topics.ODOMETRY_RESET,
            self._on_odometry_reset,
            decode=conversions.reset_from_message,
            expected=False,
        )
        self.managed_subscription(topics.GOAL_POSE, self._on_goal)
        self.managed_subscription(topics.TRAJECTORY, self._on_trajectory)
        self.managed_subscription(topics.VELOCITY, self._on_velocity, expected=False)
        for name, request in (
            ("takeoff", self._live.take_off),
            ("start", self._live.start),
            ("hold", self._live.hold),
            ("land", self._live.land),
        ):
            serve = functools.partial(self._serve, name, request)
            self.managed_service(Trigger, f"~/{name}", serve)
        if not config.lockstep:
            self.managed_beat(1.0 / config.publish_rate, self._on_beat)

    def activate(self) -> None:
        """Start, or continue at the time of the last stop."""
        self._time.resume(self._now_ns())
        self._sent = None
        self._publish_path(self._live.planned_samples(self._flight_ns()))

    def deactivate(self) -> None:
        """Stop the time of the flight."""
        with self._publishing:  # complete a window in progress
            self._time.pause(self._now_ns())

    def loss_in_flight(self) -> str | None:
        """Return the consequence of stopping; None if no trajectory is flown."""
        if not self._live.started or self._live.mode(self._flight_ns()) == GROUND:
            return None
        return "stopped publishing the reference; the MPC's failsafe takes over"

    def cleanup(self) -> None:
        """Release the trajectory."""
        del self._live

    def _prepared(self) -> LiveReference:
        joined = functools.cache(functools.partial(joined_trajectory, self._config))
        if self._config.mode == "on_request":
            return LiveReference(self._config, joined(), joined=joined)
        trajectory = configured_trajectory(self._config)
        return LiveReference(
            self._config, trajectory, joined=(lambda: trajectory) if trajectory.smooth else joined
        )

    def _on_odometry(self, data: bytes) -> None:
        if not self.active:
            return
        if not self._config.lockstep:
            self._stamps.note(cdr.header_stamp_ns(data), now_ns=self._now_ns())
            if not self._live.needs_odometry(self._flight_ns()):
                return  # most odometries need no decoding in real time
        try:
            odometry = odometry_in(data)
        except ValueError:
            return  # the controller warns about it
        if odometry_fault(odometry, frame_id=self._config.frame_id) is not None:
            return  # the controller warns about it
        starting = not self._live.started
        now_ns = odometry.stamp_ns - self._stamps.ahead_ns
        reply = self._live.observe(replace(odometry, stamp_ns=self._time.at(now_ns)))
        if reply is not None:
            self._report_request("touchdown" if reply.accepted else "odometry", reply)
        if starting or self._config.lockstep:
            self._newest_ns = odometry.stamp_ns
            with self._publishing:
                self._publish(now_ns)

    def _on_beat(self) -> None:
        with self._publishing:
            if self.active:
                self._publish(self._now_ns(), if_due=True)

    def _is_due(self, published: Published, now_ns: int) -> bool:
        """Return whether the last window is outdated or ends too soon."""
        sent = self._sent
        return (
            sent is None
            or published.version is None
            or published.version is not sent.version
            or self._stamps.ahead_ns != sent.ahead_ns
            or abs(now_ns - sent.at_ns) >= self._renewal_ns
            or published.changes(self._time.at(sent.at_ns), self._time.at(now_ns))
        )

    def _on_engaged(self, message: Any) -> None:
        reply = self._live.engage(bool(message.data))
        if reply is not None:
            self._report_request("handover", reply)

    def _on_landed(self, message: Any) -> None:
        self._live.landed(bool(message.data))

    def _on_ground_state(self, message: Any) -> None:
        self._live.set_ground_state(conversions.ground_state_from_message(message))

    def _on_odometry_reset(self, reset: EstimateReset) -> None:
        with self._publishing:
            reply = self._live.reset_estimate(self._flight_ns(), reset)
            if self.active and not self._config.lockstep:
                self._publish(self._now_ns())
        self._report_request("reset", reply)

    def _serve(self, name: str, request: Callable[[int], Reply], _: Any, response: Any) -> Any:
        reply = self._handle(name, request)
        response.success, response.message = reply.accepted, reply.text
        return response

    def _on_goal(self, message: Any) -> None:
        frame_id, p_WB, q_WB_xyzw = conversions.pose_from_message(message)
        request = functools.partial(
            self._live.go_to, frame_id=frame_id, p_WB=p_WB, q_WB_xyzw=q_WB_xyzw
        )
        self._handle("goal", request)

    def _on_trajectory(self, message: Any) -> None:
        try:
            window = conversions.reference_from_message(message)
        except ValueError as error:
            self._report_request("trajectory", Reply(accepted=False, text=str(error)))
            return
        self._handle("trajectory", lambda now_ns: self._live.follow(now_ns, window))

    def _on_velocity(self, message: Any) -> None:
        """Follow a velocity; log its start and rejections."""
        if not self.active:
            return
        try:
            command = self._velocity_in(message)
        except ValueError as error:
            self._report_request("velocity", Reply(accepted=False, text=str(error)))
            return
        lead_ns = 0 if self._config.lockstep else _VELOCITY_LEAD_NS
        reply = self._live.move(self._flight_ns() + lead_ns, command)
        if reply is not None and reply is not TOO_LATE:  # the next velocity follows soon
            self._report_request("velocity", reply)

    def _velocity_in(self, message: Any) -> VelocityCommand:
        """Return a received velocity. Raises ``ValueError`` if unusable."""
        frame_id, velocity, turn = conversions.twist_from_message(message)
        if frame_id not in ("", _BODY_FRAME, self._config.frame_id):
            raise ValueError(
                f"frame {frame_id!r}, expected {_BODY_FRAME!r} (body axes) or "
                f"{self._config.frame_id!r}"
            )
        return VelocityCommand(
            velocity=velocity,
            yaw_rate=float(turn[2]),
            heading_aligned=frame_id != self._config.frame_id,
        )

    def _handle(self, name: str, request: Callable[[int], Reply]) -> Reply:
        """Execute a request, report its result and publish the new path."""
        reply = self._planned(request) if self.active else _INACTIVE
        self._report_request(name, reply)
        if reply.accepted:
            self._publish_path(self._live.planned_samples(self._flight_ns()))
        return reply

    def _planned(self, request: Callable[[int], Reply]) -> Reply:
        """Execute a request with a lead time that is sufficient for planning."""
        if self._config.lockstep:  # time is stopped while planning
            return request(self._flight_ns())
        lead_ns = _PLANNING_LEAD_NS
        reply = TOO_LATE
        for _ in range(_MAX_ATTEMPTS):
            begun_ns = time.monotonic_ns()
            reply = request(self._flight_ns() + lead_ns)
            if reply is not TOO_LATE:
                break
            lead_ns = _PLANNING_LEAD_NS + round(_LEAD_FACTOR * (time.monotonic_ns() - begun_ns))
        return reply

    def _report_request(self, name: str, reply: Reply) -> None:
        """Log and report the result of a request; log a repeated rejection once."""
        before = self._request
        self._request = f"{name} {'accepted' if reply.accepted else 'refused'}: {reply.text}"
        if reply.accepted:
            self.get_logger().info(self._request)
        elif self._request != before:
            self.get_logger().warning(self._request)
        else:
            return
        self.health.report()

    def _publish(self, now_ns: int, *, if_due: bool = False) -> None:
        published = self._live.published
        if published is None or (if_due and not self._is_due(published, now_ns)):
            return
        ahead_ns = self._stamps.ahead_ns
        window = replace(published.window(self._time.at(now_ns)), stamp_ns=now_ns + ahead_ns)
        self._sent = _PublishedWindow(published.version, ahead_ns, now_ns)
        self._reference.publish(cdr.written_reference(window, child_frame_id=_BODY_FRAME))

    def _publish_path(self, samples: TrajectorySamples) -> None:
        stamp_ns = int(self.get_clock().now().nanoseconds)
        path = cdr.written_path(
            stamp_ns=stamp_ns,
            step_ns=0,
            frame_id=self._config.frame_id,
            p_WB=samples.p_WB,
            q_WB_xyzw=samples.q_WB_xyzw,
        )
        self._path.publish(path)

    def _flight_ns(self) -> int:
        """Return the time of the flight [ns]."""
        return self._time.at(self._now_ns())

    def _now_ns(self) -> int:
        """Return the steady time, or in lockstep the stamp of the newest odometry [ns]."""
        return self._newest_ns if self._config.lockstep else self._steady.now_ns()

    def report(self) -> Health:
        """Return the health: trajectory, mode and last request."""
        if self._live.started:
            text, level = "flying", OK
        elif self._live.waits:
            text, level = "waiting at the vehicle until it executes commands", OK
        elif self._config.mode == "at_once":
            text, level = "waiting for odometry; holding the start of the trajectory", OK
        else:
            text, level = "waiting for odometry", WARN
        return Health(
            level=level,
            text=text,
            values=[
                ("trajectory", self._config.trajectory),
                ("mode", self._live.mode(self._flight_ns())),
                ("request", self._request),
            ],
        )


main = functools.partial(run, ReferenceNode)

if __name__ == "__main__":
    sys.exit(main())
