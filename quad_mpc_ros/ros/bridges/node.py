# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The node that runs a bridge: topics and services."""

from __future__ import annotations

import dataclasses
import functools
import importlib.util
from collections.abc import Callable
from typing import Any

from std_srvs.srv import SetBool

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.messages import conversions, topics
from quad_mpc_ros.messages.diagnostics import OK, WARN
from quad_mpc_ros.messages.topics import Topic
from quad_mpc_ros.ros.bridges.bridge import (
    Bridge,
    Outgoing,
    OutgoingMessage,
    Response,
    ServiceCall,
    Subscription,
)
from quad_mpc_ros.ros.bridges.config import BridgeConfig
from quad_mpc_ros.ros.bridges.line import ReconnectingLine
from quad_mpc_ros.ros.bridges.thrust import thrust_map_findings
from quad_mpc_ros.ros.clocks import SteadyTime, create_steady_timer
from quad_mpc_ros.ros.health import Health, ReportingNode
from quad_mpc_ros.ros.messages import message_class, new_message
from quad_mpc_ros.ros.preflight.finding import Level
from quad_mpc_ros.ros.preflight.own import LANDED_KEY, STACK_FAULT_KEY
from quad_mpc_ros.ros.repeated_warnings import RepeatedWarnings
from quad_mpc_ros.ros.spin import run
from quad_mpc_ros.ros.vehicle_watch import VehicleWatch

_BRIDGE_TOPICS = (
    *(topics.ODOMETRY, topics.ODOMETRY_RESET, topics.REFERENCE, topics.ENGAGED, topics.LANDED),
    topics.GROUND_STATE,
)
_LOG_PERIOD = 5.0
_OUTCOME_PERIOD = 0.05
_COMMAND_TIMEOUT_NS = 500_000_000


class BridgeNode(ReportingNode[BridgeConfig]):
    """Connects a bridge to its topics and to the services ``~/arm`` and ``~/engage``."""

    def __init__(self, kind: type[Bridge]) -> None:
        _require(kind)
        self._line: ReconnectingLine | None = None  # ROS may destroy an incomplete node
        super().__init__(kind.name, kind.Config)
        self._bridge = bridge = kind.configured(self.config, _new)
        command = dataclasses.replace(topics.COMMAND, name=self.config.mpc_command_topic)
        self._check_topic_types(command)
        self._check_message_types()
        self._silence = ""
        self._warnings = RepeatedWarnings(self)
        self._command_ns = 0
        self._odometry = self.health.publisher(topics.ODOMETRY)
        self._odometry_message = new_message(topics.ODOMETRY.type_name)
        self._odometry_reset = self.health.publisher(topics.ODOMETRY_RESET)
        self._odometries = 0
        self._engaged = self.health.publisher(topics.ENGAGED)
        self._engaged_message = new_message(topics.ENGAGED.type_name)
        self._publish_engaged(False)
        self._landed = self.health.publisher(topics.LANDED)
        self._published_landed: bool | None = None
        self._time = SteadyTime(self.get_clock())
        self._stack = {each.name: self.health.publisher(each) for each in bridge.publications}
        self._clients_by_name = {
            name: self.create_client(message_class(type_name), name)
            for name, type_name in bridge.services
        }
        self._own_findings = list(thrust_map_findings(self.config))
        for finding in self._own_findings:
            self.get_logger().warning(finding.text)
        self._vehicles = VehicleWatch(self, self.config.vehicle_values())
        self.health.watch = self._vehicles
        self.health.subscription(
            topics.DIAGNOSTICS, self._vehicles.receive, raw=True, expected=False
        )
        self.health.subscription(topics.REFERENCE, self._on_reference, expected=False)
        self.health.subscription(topics.GROUND_STATE, self._on_ground_state, expected=False)
        self.health.subscription(command, self._on_command)
        for each in bridge.subscriptions:
            self.health.subscription(each.topic, functools.partial(self._on_stack, each))
        engage, arm = (functools.partial(self._serve, ask) for ask in (bridge.engage, bridge.arm))
        self.create_service(SetBool, "~/engage", engage)
        arming = self.create_service(SetBool, "~/arm", arm)
        # The response waits for the outcome, for seconds: rclpy has no other deferred response.
        self._answer_arm, arming.send_response = arming.send_response, self._hold_answer
        self._held_answers: list[tuple[Any, Any]] = []
        create_steady_timer(self, _OUTCOME_PERIOD, self._answer_held)
        if bridge.leave is not None:  # ROS must not be shut down before
            self.drain = self._send_last
        self._line = bridge.line
        if self._line is not None:
            create_steady_timer(self, self._line.period, self._on_line)

    def destroy_node(self) -> None:
        """Close the line as well."""
        if self._line is not None:
            self._line.close()
        super().destroy_node()

    def _send_last(self, _spin_once: Callable[[], None]) -> None:
        assert self._bridge.leave is not None
        for outgoing in self._bridge.leave():
            self._send(outgoing)

    def _check_topic_types(self, command: Topic) -> None:
        """Reject two types on one topic: DDS would use only the first."""
        stack = (*(each.topic for each in self._bridge.subscriptions), *self._bridge.publications)
        ours = {self.resolve_topic_name(each.name): each for each in (command, *_BRIDGE_TOPICS)}
        for topic in stack:
            same = ours.get(self.resolve_topic_name(topic.name))
            if same is not None and same.type_name != topic.type_name:
                raise UserError(
                    f"{self._bridge.name}: topic {topic.name} has the type {topic.type_name} in "
                    f"the stack and {same.type_name} here: start it in a namespace, or set "
                    "advanced.mpc_command_topic and remap the mpc's topic command to it"
                )

    def _check_message_types(self) -> None:
        """Reject installed message packages without a required type."""
        bridge = self._bridge
        for type_name in (
            *(each.topic.type_name for each in bridge.subscriptions),
            *(topic.type_name for topic in bridge.publications),
            *(type_name for _, type_name in bridge.services),
        ):
            try:
                message_class(type_name)
            except AttributeError:
                package = type_name.partition("/")[0]
                raise UserError(
                    f"{bridge.name}: the installed {package} is another release, "
                    f"without {type_name}: {bridge.how_to_get}"
                ) from None

    def _on_command(self, message: Any) -> None:
        self._command_ns = now_ns = self._time.now_ns()
        command = conversions.command_from_message(message)
        for outgoing in self._bridge.receive_command(command, now_ns=now_ns):
            self._send(outgoing)
        self._follow_engagement(now_ns)
        if self._bridge.silence != self._silence:
            self._silence = self._bridge.silence
            self.get_logger().info(
                self._silence or "commands are sent", throttle_duration_sec=_LOG_PERIOD
            )

    def _on_reference(self, message: Any) -> None:
        try:
            window = conversions.reference_from_message(message)
        except ValueError:
            return  # the controller warns about it
        self._bridge.receive_reference(window, now_ns=self._time.now_ns())

    def _on_ground_state(self, message: Any) -> None:
        self._bridge.receive_ground(conversions.ground_state_from_message(message))

    def _on_stack(self, subscription: Subscription, message: Any) -> None:
        now_ns = self._time.now_ns()
        subscription.receive(message, now_ns)
        self._publish_state(now_ns)

    def _on_line(self) -> None:
        assert self._line is not None
        now_ns = self._time.now_ns()
        self._line.write(self._bridge.exchange(self._line.read(), now_ns=now_ns))
        self._publish_state(now_ns)
        if self._line.fault:
            self._warnings.warn(self._line.fault)

    def _publish_state(self, now_ns: int) -> None:
        """Publish what the bridge has received of the stack; log its warnings."""
        for outgoing in self._bridge.take_outgoing():
            self._send(outgoing)
        self._follow_engagement(now_ns)
        for odometry, reset in self._bridge.take_odometries():
            self._publish_odometry(odometry, reset)
        for warning in self._bridge.take_warnings():
            self._warnings.warn(warning)

    def _publish_odometry(self, odometry: OdometrySample, reset: EstimateReset | None) -> None:
        if reset is not None:  # first: the odometry is in the new coordinates
            message = new_message(topics.ODOMETRY_RESET.type_name)
            conversions.fill_reset(message, reset)
            self._odometry_reset.publish(message)
        conversions.fill_odometry(self._odometry_message, odometry)
        self._odometry.publish(self._odometry_message)
        self._odometries += 1

    def _follow_engagement(self, now_ns: int) -> None:
        """Publish changes of ``engaged`` and ``landed``."""
        engaged = self._bridge.engaged(now_ns=now_ns)
        if engaged is not self._engaged_message.data:
            self._publish_engaged(engaged)
        landed = self._bridge.landed(now_ns=now_ns)
        if landed is not None and landed is not self._published_landed:
            self._published_landed = landed
            message = new_message(topics.LANDED.type_name)
            message.data = landed
            self._landed.publish(message)

    def _publish_engaged(self, engaged: bool) -> None:
        self._engaged_message.data = engaged
        self._engaged.publish(self._engaged_message)

    def _serve(self, ask: Callable[..., Response], request: Any, response: Any) -> Any:
        """Send a request to the stack; the response of the stack is logged when it arrives."""
        blocker = self._engage_blocker() if request.data else ""
        if blocker:
            response.success, response.message = False, blocker
            self.get_logger().info(blocker)
            return response
        decided = ask(bool(request.data), now_ns=self._time.now_ns())
        missing = [
            call.service
            for call in decided.calls
            if not call.optional and not self._clients_by_name[call.service].service_is_ready()
        ]
        response.success = decided.accepted and not missing
        response.message = f"service {missing[0]} is not available" if missing else decided.text
        if response.success:
            for outgoing in (*decided.messages, *decided.calls):
                self._send(outgoing)
        self._follow_engagement(self._time.now_ns())
        self.get_logger().info(response.message)
        return response

    def _hold_answer(self, response: Any, header: Any) -> None:
        """Respond to a request to arm or disarm, unless its outcome is pending."""
        if response.success:
            self._held_answers.append((response, header))
        else:
            self._answer_arm(response, header)

    def _answer_held(self) -> None:
        """Respond to pending requests to arm or disarm with the outcome of the newest."""
        if not self._held_answers:
            return
        outcome = self._bridge.arming_outcome(now_ns=self._time.now_ns())
        if outcome is None:
            return
        for response, header in self._held_answers:
            response.success, response.message = outcome.accepted, outcome.text
            self._answer_arm(response, header)
            self.get_logger().info(outcome.text)
        self._held_answers.clear()

    def _engage_blocker(self) -> str:
        """Return the errors that must be fixed before arming or engaging, or an empty string."""
        found = [*self._own_findings, *self._vehicles.contradictions()]
        errors = [finding.text for finding in found if finding.level is Level.ERROR]
        if duplicates := self.health.duplicate_publishers():
            errors.insert(0, f"{duplicates}: stop the others first")
        return "; ".join(errors)

    def _on_answered(self, call: ServiceCall, future: Any) -> None:
        if call.receive is not None:
            call.receive(future.result())
        else:
            self.get_logger().info(f"{call.service} answered {future.result()}")

    def _send(self, outgoing: Outgoing) -> None:
        if isinstance(outgoing, OutgoingMessage):
            self._stack[outgoing.topic.name].publish(outgoing.message)
        elif isinstance(outgoing, bytes):
            assert self._line is not None
            self._line.write(outgoing)
        else:
            self._request(outgoing)

    def _request(self, call: ServiceCall) -> None:
        client = self._clients_by_name[call.service]
        if not client.service_is_ready():
            if not call.optional:
                self.get_logger().warning(f"service {call.service} is not available")
            return
        future = client.call_async(call.request)
        future.add_done_callback(functools.partial(self._on_answered, call))

    def report(self) -> Health:
        """Return whether commands are sent to the stack, or the reason for silence."""
        bridge, now_ns = self._bridge, self._time.now_ns()
        quiet = now_ns - self._command_ns > _COMMAND_TIMEOUT_NS
        fault = bridge.stack_fault(now_ns=now_ns)
        silence = "silent: no commands from the mpc" if quiet else bridge.silence
        text = "; ".join(dict.fromkeys(filter(None, (fault, silence))))
        landed = self._published_landed
        return Health(
            level=WARN if text else OK,
            text=text or "commands are sent",
            values=[
                ("odometries", str(self._odometries)),
                ("refused_odometries", str(bridge.refused)),
                ("jumps", str(bridge.jumps)),
                ("commands", str(bridge.commands)),
                ("passed_commands", str(bridge.passed)),
                ("engaged", str(self._engaged_message.data).lower()),
                ("handover", bridge.handover[0]),
                (LANDED_KEY, "unknown" if landed is None else str(landed).lower()),
                (STACK_FAULT_KEY, fault),
                ("battery_scale", f"{bridge.thrust.battery_scale:.3f}"),
            ],
        )


def run_bridge(kind: type[Bridge], args: list[str] | None = None) -> int:
    """Run the node of a bridge and return its exit code."""
    return run(functools.partial(BridgeNode, kind), args)


def _require(kind: type[Bridge]) -> None:
    """Raise :class:`UserError` with the installation of missing message packages."""
    missing = [name for name in kind.packages if importlib.util.find_spec(name) is None]
    if missing:
        raise UserError(
            f"{kind.name}: the message package {', '.join(missing)} is not installed: "
            f"{kind.how_to_get}"
        )


def _new(type_name: str) -> Any:
    """Return an empty message or service request."""
    if "/srv/" in type_name:
        return message_class(type_name).Request()
    return new_message(type_name)
