"""The node around any bridge: its topics and services, and nothing of what they mean."""

from __future__ import annotations

import dataclasses
import functools
import importlib.util
from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock, ClockType
from std_srvs.srv import SetBool

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.model.samples import OdometrySample
from quad_mpc_ros.messages import conversions
from quad_mpc_ros.messages.diagnostics import OK, WARN
from quad_mpc_ros.messages.topics import (
    COMMAND,
    ENGAGED,
    LANDED,
    ODOMETRY,
    ODOMETRY_RESET,
    REFERENCE,
    Topic,
)
from quad_mpc_ros.ros.bridges.bridge import (
    Bridge,
    Outgoing,
    OutgoingBytes,
    OutgoingMessage,
    Response,
    ServiceCall,
    Subscription,
)
from quad_mpc_ros.ros.bridges.config import BridgeConfig
from quad_mpc_ros.ros.bridges.serial_line import SerialLine
from quad_mpc_ros.ros.clocks import SteadyTime
from quad_mpc_ros.ros.health import Health, ReportingNode
from quad_mpc_ros.ros.messages import message_class, new_message
from quad_mpc_ros.ros.spin import run

_OURS = (ODOMETRY, ODOMETRY_RESET, REFERENCE, ENGAGED, LANDED)
_WARNING_PERIOD = 5.0
_QUIET_NS = 500_000_000
_LINE_PERIOD = 0.005


class BridgeNode(ReportingNode[BridgeConfig]):
    """Wires a bridge. The services ``~/arm`` and ``~/engage`` ask what nothing else does."""

    def __init__(self, kind: type[Bridge]) -> None:
        _require(kind)
        super().__init__(kind.name, kind.Config)
        self._bridge = kind(self.config, _new)
        command = dataclasses.replace(COMMAND, name=self.config.mpc_command_topic)
        self._refuse_clashes(command)
        self._refuse_other_releases()
        self._silence = ""
        self._command_ns = 0
        self._odometry = self.health.publisher(ODOMETRY)
        self._odometry_message = new_message(ODOMETRY.type_name)
        self._odometry_reset = self.health.publisher(ODOMETRY_RESET)
        self._odometries = 0
        self._engaged = self.health.publisher(ENGAGED)
        self._engaged_message = new_message(ENGAGED.type_name)
        self._tell_engaged(False)
        self._landed = self.health.publisher(LANDED)
        self._told_landed: bool | None = None
        self._time = SteadyTime(self.get_clock())
        self._stack = {
            topic.name: self.health.publisher(topic) for topic in self._bridge.publications
        }
        self._clients_by_name = {
            name: self.create_client(message_class(type_name), name)
            for name, type_name in self._bridge.services
        }
        self.health.subscription(REFERENCE, self._on_reference, expected=False)
        self.health.subscription(command, self._on_command)
        for subscription in self._bridge.subscriptions:
            self.health.subscription(
                subscription.topic, functools.partial(self._on_stack, subscription)
            )
        for name, ask in (("arm", self._bridge.arm), ("engage", self._bridge.engage)):
            self.create_service(SetBool, f"~/{name}", functools.partial(self._serve, ask))
        self._line = SerialLine(self._bridge.line) if self._bridge.line is not None else None
        if self._line is not None:
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            self.create_timer(_LINE_PERIOD, self._on_line, clock=steady)

    def _refuse_clashes(self, command: Topic) -> None:
        """Refuse two types under one name, of which DDS takes only the first."""
        stack = (*(each.topic for each in self._bridge.subscriptions), *self._bridge.publications)
        ours = {self.resolve_topic_name(each.name): each for each in (command, *_OURS)}
        for topic in stack:
            same = ours.get(self.resolve_topic_name(topic.name))
            if same is not None and same.type_name != topic.type_name:
                raise UserError(
                    f"{self._bridge.name}: {topic.name} is the stack's, of type "
                    f"{topic.type_name}, and ours, of type {same.type_name}: start it in a "
                    "namespace, or set advanced.mpc_command_topic and remap the mpc's topic "
                    "command to it"
                )

    def _refuse_other_releases(self) -> None:
        """Refuse message packages that are installed and lack a type."""
        bridge = self._bridge
        topics = (*(each.topic for each in bridge.subscriptions), *bridge.publications)
        for type_name in (
            *(topic.type_name for topic in topics),
            *(type_name for _, type_name in bridge.services),
        ):
            try:
                message_class(type_name)
            except AttributeError:
                package = type_name.partition("/")[0]
                raise UserError(
                    f"{bridge.name}: the installed {package} has no {type_name}, it is of "
                    f"another release: {bridge.how_to_get}"
                ) from None
            except ModuleNotFoundError:
                pass  # which :func:`_require` has told

    def _on_command(self, message: Any) -> None:
        self._command_ns = now_ns = self._time.now_ns()
        command = conversions.command_from_message(message)
        for outgoing in self._bridge.receive_command(command, now_ns=now_ns):
            self._send(outgoing)
        self._follow_engagement(now_ns)
        if self._bridge.silence != self._silence:
            self._silence = self._bridge.silence
            # Ages differ from one to the next.
            self.get_logger().info(
                self._silence or "commands pass", throttle_duration_sec=_WARNING_PERIOD
            )

    def _on_reference(self, message: Any) -> None:
        try:
            window = conversions.reference_from_message(message)
        except ValueError:
            return  # the controller warns of it
        self._bridge.receive_reference(window, now_ns=self._time.now_ns())

    def _on_stack(self, subscription: Subscription, message: Any) -> None:
        now_ns = self._time.now_ns()
        odometry = subscription.receive(message, now_ns)
        self._follow_engagement(now_ns)
        if odometry is not None:
            self._publish_odometry(odometry)
        for warning in self._bridge.take_warnings():
            self.get_logger().warning(warning, throttle_duration_sec=_WARNING_PERIOD)

    def _on_line(self) -> None:
        assert self._line is not None
        now_ns = self._time.now_ns()
        self._line.write(self._bridge.exchange(self._line.read(), now_ns=now_ns))
        self._follow_engagement(now_ns)
        warnings = self._bridge.take_warnings()
        for warning in [*warnings, *filter(None, [self._line.fault])]:
            self.get_logger().warning(warning, throttle_duration_sec=_WARNING_PERIOD)

    def _publish_odometry(self, odometry: OdometrySample) -> None:
        reset = self._bridge.announced_reset
        if reset is not None:  # first, for what follows is in other coordinates
            message = new_message(ODOMETRY_RESET.type_name)
            conversions.fill_reset(message, reset)
            self._odometry_reset.publish(message)
        conversions.fill_odometry(self._odometry_message, odometry)
        self._odometry.publish(self._odometry_message)
        self._odometries += 1

    def _follow_engagement(self, now_ns: int) -> None:
        """Let the MPC know when the vehicle begins to act on commands, and when it ceases to."""
        engaged = self._bridge.engaged(now_ns=now_ns)
        if engaged is not self._engaged_message.data:
            self._tell_engaged(engaged)
        landed = self._bridge.landed(now_ns=now_ns)
        if landed is not None and landed is not self._told_landed:
            self._told_landed = landed
            message = new_message(LANDED.type_name)
            message.data = landed
            self._landed.publish(message)

    def _tell_engaged(self, engaged: bool) -> None:
        self._engaged_message.data = engaged
        self._engaged.publish(self._engaged_message)

    def _serve(self, ask: Callable[..., Response], request: Any, response: Any) -> Any:
        """Send what was asked for; the stack's own response is logged when it comes."""
        rivals = self.health.rivals() if request.data else ""
        if rivals:
            response.success, response.message = False, f"{rivals}: end the others first"
            self.get_logger().info(response.message)
            return response
        decided = ask(bool(request.data), now_ns=self._time.now_ns())
        missing = [
            call.service
            for call in decided.calls
            if not self._clients_by_name[call.service].service_is_ready()
        ]
        response.success = decided.accepted and not missing
        response.message = f"nobody offers the service {missing[0]}" if missing else decided.text
        if response.success:
            for message in decided.messages:
                self._send(message)
            for call in decided.calls:
                self._send(call)
        self._follow_engagement(self._time.now_ns())
        self.get_logger().info(response.message)
        return response

    def _on_answered(self, service: str, future: Any) -> None:
        self.get_logger().info(f"{service} answers {future.result()}")

    def _send(self, outgoing: Outgoing) -> None:
        if isinstance(outgoing, OutgoingMessage):
            self._stack[outgoing.topic.name].publish(outgoing.message)
        elif isinstance(outgoing, OutgoingBytes):
            assert self._line is not None
            self._line.write(outgoing.data)
        else:
            self._request(outgoing)

    def _request(self, call: ServiceCall) -> None:
        client = self._clients_by_name[call.service]
        if not client.service_is_ready():
            self.get_logger().warning(f"nobody offers the service {call.service}")
            return
        future = client.call_async(call.request)
        future.add_done_callback(functools.partial(self._on_answered, call.service))

    def report(self) -> Health:
        """Return what is sent to the stack, or why nothing is."""
        bridge = self._bridge
        quiet = self._time.now_ns() - self._command_ns > _QUIET_NS
        text = "silent: no command comes" if quiet else bridge.silence
        return Health(
            level=WARN if text else OK,
            text=text or "commands pass",
            values=[
                ("odometries", str(self._odometries)),
                ("refused_odometries", str(bridge.refused)),
                ("jumps", str(bridge.jumps)),
                ("commands", str(bridge.commands)),
                ("passed_commands", str(bridge.passed)),
                ("engaged", str(self._engaged_message.data).lower()),
                ("handover", bridge.handover[0]),
                (
                    "landed",
                    "not told" if self._told_landed is None else str(self._told_landed).lower(),
                ),
                ("battery_scale", f"{bridge.thrust.battery_scale:.3f}"),
            ],
        )


def run_bridge(kind: type[Bridge], args: list[str] | None = None) -> int:
    """Run the node of a bridge and return its exit code."""
    return run(functools.partial(BridgeNode, kind), args)


def _require(kind: type[Bridge]) -> None:
    """Say how to get a message package that is missing. Raises :class:`UserError`."""
    missing = [name for name in kind.packages if importlib.util.find_spec(name) is None]
    if missing:
        raise UserError(
            f"{kind.name}: the message package {', '.join(missing)} is not installed: "
            f"{kind.how_to_get}"
        )


def _new(type_name: str) -> Any:
    """Return an empty message, or the empty request of a service."""
    if "/srv/" in type_name:
        return message_class(type_name).Request()
    return new_message(type_name)
