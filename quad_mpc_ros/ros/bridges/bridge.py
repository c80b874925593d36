# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The interface of all bridges: the rules and messages of a flight stack.

A bridge converts the stack's state into odometry and the MPC's commands into the stack's messages.
The bridge uses neither ROS nor a clock: the caller passes the time and a function that creates
empty messages. So the same object runs in a node, in a test and in a simulation. The file of a
bridge has the codec, functions with frame and unit in their names, and the rules, a subclass of
:class:`Bridge`.

Every bridge obeys these rules:

- The bridge sends only in response to a fresh command and has no timer. If the MPC stops, the
  stack receives nothing, not even a heartbeat, and the stack's failsafe acts. (Betaflight holds
  the last sticks, so its bridge has a ``line`` for a controlled descent.)
- The bridge rejects values that are not finite or not in a known frame, with a reason.
- The bridge passes on a reset of the estimator: same frame, next stamp, another position.
- The bridge arms and switches modes only on request, and sends nothing before a request to engage.
  (ArduPilot is set to its landing mode after a landing, because it does not disarm otherwise. In
  its external mode PX4 gets answers to its requests, and Hold if the MPC stops in flight.)
- The bridge refuses to engage and to arm if the vehicle would jump. The release is permanent if
  another source takes over or commands have stopped (:mod:`.handover`).
- Disarming is forced: the motors stop also in the air. The bridge releases the vehicle at once. A
  bridge that cannot disarm its stack refuses and names the tool that can.
- The bridge reports whether the vehicle executes commands. Until then, the reference waits at the
  vehicle and the MPC does not estimate. If known, the bridge reports whether the vehicle landed.
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from quad_mpc_ros.control.estimation.ground_state import GroundState
from quad_mpc_ros.control.model.estimate_reset import EstimateReset
from quad_mpc_ros.control.model.samples import CommandSample, OdometrySample, ReferenceWindow
from quad_mpc_ros.control.safety.validation import odometry_fault
from quad_mpc_ros.messages.conversions import NewMessage, odometry_from_message
from quad_mpc_ros.messages.topics import Topic
from quad_mpc_ros.ros.bridges.config import BridgeConfig
from quad_mpc_ros.ros.bridges.handover import (
    Ground,
    Handover,
    HandoverConditions,
    HandoverState,
    Stack,
)
from quad_mpc_ros.ros.bridges.line import ReconnectingLine
from quad_mpc_ros.ros.bridges.odometry import OdometryStamps
from quad_mpc_ros.ros.bridges.thrust import ThrustMap

FORCED = 21196.0
"""Second parameter of MAV_CMD_COMPONENT_ARM_DISARM: disarm in the air as well."""

_MAX_BODY_RATE = 100.0  # rad/s: beyond the range of gyroscopes
_COMMAND_TIMEOUT = 0.1  # s: a command with an older stamp is not passed on
_SWITCH_RETRY_NS = 1_000_000_000
_MAV_RESULTS = "accepted", "temporarily rejected", "denied", "unsupported", "failed"
_ARMING_TIMEOUT_NS = 3_000_000_000  # until the stack reports what was requested
_REFUSAL_REASON_NS = 500_000_000  # for texts with the reason of a refusal


@dataclass(frozen=True, kw_only=True)
class Subscription:
    """A topic of the stack and the function that receives its messages.

    ``receive`` is called with a message and its time of arrival [ns]. ``receive`` may return
    the received odometry, which :meth:`Bridge.take_odometries` returns as well.
    """

    topic: Topic
    receive: Callable[[Any, int], OdometrySample | None]


@dataclass(frozen=True, kw_only=True)
class OutgoingMessage:
    """A filled message and the topic of the stack to publish it on."""

    topic: Topic
    message: Any


@dataclass(frozen=True, kw_only=True)
class ServiceCall:
    """A filled request and the service of the stack to call.

    ``type_name`` is like ``std_srvs/srv/SetBool``. ``receive``, if not None, is called with the
    response. An ``optional`` call is skipped if no node provides the service.
    """

    service: str
    type_name: str
    request: Any
    receive: Callable[[Any], None] | None = None
    optional: bool = False


@dataclass(frozen=True, kw_only=True)
class Response:
    """The response to a request to arm or to engage, with the messages to send.

    ``text`` has the reason for a refusal.
    """

    accepted: bool
    text: str
    messages: Sequence[OutgoingMessage | bytes] = ()
    calls: Sequence[ServiceCall] = ()


Outgoing = OutgoingMessage | bytes | ServiceCall
"""What a bridge sends: a message, bytes over the line, or a call of a service."""


class Bridge(ABC):
    """Base of every bridge. Messages are sent in the order in which they are returned."""

    name: ClassVar[str]
    """Name of the executable and of the node, like ``px4_bridge``."""
    packages: ClassVar[tuple[str, ...]]
    """The required packages."""
    how_to_get: ClassVar[str]
    """How to install missing packages."""
    Config: ClassVar[type[BridgeConfig]]

    warm_up: float = 0.0
    """Time [s] for which setpoints must be sent before the request to switch to them."""
    streams: bool = False
    """Whether setpoints are sent before the stack has switched to them."""
    pilot_switches_mode: bool = False
    """Whether a pilot switches the stack to setpoints, so that the switch has no timeout."""

    leave: Callable[[], Sequence[Outgoing]] | None = None
    """Returns the messages to send at the end of the node, if any."""

    line: ReconnectingLine | None = None
    """The line to the stack, None for a stack with topics."""

    subscriptions: Sequence[Subscription] = ()
    """The subscribed topics."""
    publications: Sequence[Topic] = ()
    """The published topics."""
    services: Sequence[tuple[str, str]] = ()
    """Name and type of each service that the bridge may call."""

    def __init__(self, config: Any, new: NewMessage, *, namespace: str = "") -> None:
        """Initialise; a derived class also sets its subscriptions and publications.

        Args:
            config: An instance of ``Config``.
            new: Creates empty messages and service requests by type name.
            namespace: Namespace of the stack's topics and services.
        """
        self.thrust = ThrustMap(config)
        self.silence = "waiting for a command"
        self.commands = self.passed = self.refused = self.jumps = 0
        self._new = new
        self._config = config
        self._namespace = namespace
        self._stamps = OdometryStamps()
        self._newest: OdometrySample | None = None  # published odometry, and its arrival
        self._newest_ns: int | None = None
        self._odometries: list[tuple[OdometrySample, EstimateReset | None]] = []
        self._warnings: list[str] = []
        self._handover = Handover(config.handover, by_pilot=self.pilot_switches_mode)
        self._handover_conditions = HandoverConditions()
        self._ground, self._mpc_ground = Ground(), GroundState.UNKNOWN
        self._arming: tuple[bool, int] | None = None  # requested state, and when [ns]
        self._refusal: list[str] = []  # refusal of that request
        self._reasons: list[str] = []  # texts of the stack since then
        self._requested_ns: int | None = None

    @classmethod
    def configured(cls, config: Any, new: NewMessage) -> Bridge:
        """Return the bridge for a configuration, which may be one of a derived class."""
        return cls(config, new)

    @abstractmethod
    def _stack(self, now_ns: int) -> Stack:
        """Return the state that the stack reports now."""

    def _switch(self) -> Sequence[Outgoing]:
        """Return the messages that request the mode for setpoints."""
        return ()

    def _switch_back(self, now_ns: int) -> Response:
        """Return the response that switches the stack back to its own control."""
        return Response(accepted=True, text="released")

    def _arm(self, wanted: bool) -> Response:
        """Return the response that arms or disarms (also in the air), or an error."""
        return Response(accepted=False, text="arm the vehicle with the tools of its own stack")

    @abstractmethod
    def _messages(self, command: CommandSample, now_ns: int) -> Sequence[Outgoing]:
        """Return the messages for a fresh command."""

    def exchange(self, received: bytes, *, now_ns: int) -> bytes:
        """Process bytes from the line and return bytes to send; called every few milliseconds.

        The method is called only if the bridge has a ``line``.
        """
        return b""

    def take_odometries(self) -> list[tuple[OdometrySample, EstimateReset | None]]:
        """Return the odometries to publish since the last call.

        An odometry has the announced reset of the stack's estimate, or None.
        """
        odometries, self._odometries = self._odometries, []
        return odometries

    def take_outgoing(self) -> list[Outgoing]:
        """Return the messages to send since the last call, in response to the stack's."""
        return []

    def engage(self, wanted: bool, *, now_ns: int) -> Response:
        """Hand the vehicle to the MPC on request, or take it back.

        The stack may need time for the handover; ``handover`` has the result.
        """
        if not wanted:
            self._handover.release("released on request")
            return self._switch_back(now_ns)
        self._advance(now_ns)
        if self._handover.state is not HandoverState.RELEASED:
            text = f"already requested: {self._handover.state.value}"
            return Response(accepted=True, text=text)
        blocker = self._stack(now_ns).fault or self._engage_blocker(now_ns)
        if blocker:
            return Response(accepted=False, text=blocker)
        self._handover.offer(now_ns=now_ns)
        self._requested_ns = None
        self._advance(now_ns)
        return Response(accepted=True, text=f"{self._handover.state.value}: the MPC will fly")

    def arm(self, wanted: bool, *, now_ns: int) -> Response:
        """Arm or disarm, on request; :meth:`arming_outcome` has the result.

        Disarming stops the motors of a flying vehicle.
        """
        self._advance(now_ns)
        response = self._arm(wanted)
        blocker = self._arming_blocker(now_ns) if wanted and response.accepted else ""
        if blocker:
            return Response(accepted=False, text=blocker)
        if response.accepted:
            self._arming, self._refusal, self._reasons = (wanted, now_ns), [], []
            if not wanted and self._handover.state is not HandoverState.RELEASED:
                self._handover.release("released by disarming")
        return response

    def arming_outcome(self, *, now_ns: int) -> Response | None:
        """Return the result of the last request to arm or disarm; None while it is pending."""
        if self._arming is None:
            return None
        wanted, since_ns = self._arming
        what, elapsed_ns = "armed" if wanted else "disarmed", abs(now_ns - since_ns)
        if self._reports_armed(wanted, now_ns) is wanted:
            return Response(accepted=True, text=what)
        if elapsed_ns < (_REFUSAL_REASON_NS if self._refusal else _ARMING_TIMEOUT_NS):
            return None
        unanswered = f"the stack has not reported that it is {what} within 3 s"
        return Response(
            accepted=False, text=": ".join([*(self._refusal or [unanswered]), *self._reasons])
        )

    def stack_fault(self, *, now_ns: int) -> str:
        """Return the reason why the stack cannot be flown now, or an empty string."""
        return self._stack(now_ns).fault

    def receive_reference(self, window: ReferenceWindow, *, now_ns: int) -> None:
        """Receive a reference, for the check before a handover."""
        self._handover_conditions.reference.receive(window, now_ns)

    def receive_ground(self, state: GroundState) -> None:
        """Receive the MPC's ground state, which is used while the MPC is engaged."""
        self._mpc_ground = state

    def receive_command(self, command: CommandSample, *, now_ns: int) -> list[Outgoing]:
        """Return the messages to send for a command that arrives now.

        Afterwards ``silence`` has the reason why nothing was sent, or is empty.
        """
        self.commands += 1
        fault = self._command_fault(command, now_ns)
        if fault is None:
            share = self.thrust.specific_thrust(command.throttle) / self._config.gravity
            self._handover_conditions.command.receive((command, share), now_ns)
            self._advance(now_ns)
            self._handover.commanded(now_ns=now_ns)
        if fault is None:
            fault = self._handover.reason or self._stack(now_ns).fault
        if fault:
            self.silence = fault
            return []
        stack = self._stack(now_ns)
        if not (stack.takes_setpoints or self.streams):
            self.silence = "waiting for the stack to switch to setpoints"
            return self._switch_requests(now_ns)
        self.silence = ""
        self.passed += 1
        messages: list[Outgoing] = [*self._messages(command, now_ns)]
        return messages if stack.takes_setpoints else messages + self._switch_requests(now_ns)

    def engaged(self, *, now_ns: int) -> bool:
        """Return whether the vehicle executes commands: armed, in the setpoint mode."""
        self._advance(now_ns)
        return self._handover.state is HandoverState.ENGAGED

    @property
    def handover(self) -> tuple[str, str]:
        """The value of the :class:`.HandoverState`, and the reason for a release."""
        return self._handover.state.value, self._handover.reason

    def landed(self, *, now_ns: int) -> bool | None:
        """Return whether the vehicle is on the ground; None if unknown."""
        return self._ground.landed

    def take_warnings(self) -> list[str]:
        """Return the warnings since the last call."""
        warnings, self._warnings = self._warnings, []
        return warnings

    def _advance(self, now_ns: int) -> None:
        """Advance or end the handover according to the current state."""
        before = self._handover.state
        if before is HandoverState.RELEASED:
            return
        waits = before in (HandoverState.OFFERED, HandoverState.STANDBY)
        blocker = self._engage_blocker(now_ns) if waits else ""
        self._handover.advance(self._stack(now_ns), blocker=blocker, now_ns=now_ns)
        if self._handover.state is HandoverState.RELEASED:
            self._warnings.append(self._handover.reason)

    def _engage_blocker(self, now_ns: int) -> str:
        return self._handover_conditions.blocker(landed=self.landed(now_ns=now_ns), now_ns=now_ns)

    def _arming_blocker(self, now_ns: int) -> str:
        """Return the reason why the vehicle must not be armed now, or an empty string."""
        stack = self._stack(now_ns)
        match self._handover.state:
            case HandoverState.RELEASED if stack.takes_setpoints:
                return (
                    "engage first: the stack is in its setpoint mode and would execute any "
                    "setpoint"
                )
            case HandoverState.OFFERED:
                return "engaging is in progress: try again"
            case HandoverState.STANDBY:
                return stack.fault or self._engage_blocker(now_ns)
            case _:
                return ""

    def _reports_armed(self, wanted: bool, now_ns: int) -> bool | None:
        """Return whether the stack is armed, or None, after a request for ``wanted``."""
        return self._stack(now_ns).armed

    def _refuse_arming(self, reason: str) -> None:
        """Record that the stack refused the request to arm or disarm."""
        self._warnings.append(reason)
        self._refusal = [reason]

    def _switch_requests(self, now_ns: int) -> list[Outgoing]:
        """Return the request for the setpoint mode, if setpoints were sent for long enough."""
        if self._handover.offered_for(now_ns=now_ns) < round(self.warm_up * 1e9):
            return []
        if self._requested_ns is not None and now_ns - self._requested_ns < _SWITCH_RETRY_NS:
            return []
        self._requested_ns = now_ns
        return [*self._switch()]

    def _topic(self, path: str, type_name: str, **quality: Any) -> Topic:
        """Return a topic in the stack's namespace; ``quality``: further fields of the topic."""
        return Topic(name=f"{self._namespace}/{path}", type_name=type_name, **quality)

    def _service(self, path: str, type_name: str) -> tuple[str, str]:
        """Return name and type of a service in the stack's namespace."""
        return f"{self._namespace}/{path}", type_name

    def _message(self, topic: Topic, **fields: object) -> OutgoingMessage:
        """Return an :class:`OutgoingMessage` with these fields."""
        message = self._new(topic.type_name)
        for field, value in fields.items():
            setattr(message, field, value)
        return OutgoingMessage(topic=topic, message=message)

    def _call(
        self,
        service: tuple[str, str],
        *,
        receive: Callable[[Any], None] | None = None,
        optional: bool = False,
        **fields: object,
    ) -> ServiceCall:
        """Return a :class:`ServiceCall` with these fields in its request."""
        name, type_name = service
        request = self._new(type_name)
        for field, value in fields.items():
            setattr(request, field, value)
        return ServiceCall(
            service=name, type_name=type_name, request=request, receive=receive, optional=optional
        )

    def _odometry_subscription(self, name: str) -> Subscription:
        """Return a subscription to ``nav_msgs/Odometry`` of an estimator, in ENU."""

        def receive(message: Any, now_ns: int) -> OdometrySample | None:
            return self._passed_on(odometry_from_message(message), now_ns=now_ns)

        return Subscription(
            topic=Topic(name=name, type_name="nav_msgs/msg/Odometry"), receive=receive
        )

    def _converted(
        self, source: str, convert: Callable[[], OdometrySample | None]
    ) -> OdometrySample | None:
        """Return the converted odometry; on ``ValueError`` return None and warn."""
        try:
            return convert()
        except ValueError as error:
            self._refuse(f"{source}: {error}")
            return None

    def _passed_on(
        self, odometry: OdometrySample | None, *, now_ns: int, cause: str | None = None
    ) -> OdometrySample | None:
        """Return the odometry to publish, with the MPC's clock and frames.

        ``cause`` is the announced cause of a reset of the stack's estimate. Returns None, with a
        warning, for an odometry that is invalid or not newer than the last.
        """
        if odometry is None:
            return None
        odometry = dataclasses.replace(
            odometry,
            frame_id=self._config.frame_id,
            child_frame_id=self._config.child_frame_id,
        )
        fault = odometry_fault(odometry, frame_id=odometry.frame_id)
        if fault is not None:
            self._refuse(f"the stack's state is not valid: {fault}")
            return None
        stamp_ns = self._stamps.stamp(odometry.stamp_ns, now_ns=now_ns)
        if stamp_ns is None:
            self.refused += 1
            return None
        odometry = dataclasses.replace(odometry, stamp_ns=stamp_ns)
        before, self._newest, self._newest_ns = self._newest, odometry, now_ns
        reset = None
        if before is not None and cause is not None:
            self.jumps += 1
            reset = EstimateReset.between(before, odometry)
            step = math.hypot(*reset.step_W)
            self._warnings.append(f"the odometry jumps by {step:.2f} m ({cause})")
        self._odometries.append((odometry, reset))
        self._handover_conditions.odometry.receive(odometry, now_ns)
        self._update_ground(odometry, now_ns)
        return odometry

    def _update_ground(self, odometry: OdometrySample, now_ns: int) -> None:
        """Update the ground state from height, arming and the MPC's ground state."""
        stack = self._stack(now_ns)
        if not stack.fault:
            flown = self._handover.state is HandoverState.ENGAGED
            state = self._mpc_ground if flown else GroundState.UNKNOWN
            self._ground.update(odometry.p_WB, armed=bool(stack.armed), state=state)

    def _refuse(self, reason: str) -> None:
        self.refused += 1
        self._warnings.append(reason)

    def _battery_subscription(self, topic: Topic, *, field: str = "voltage") -> list[Subscription]:
        """Return the subscription to the battery voltage, if the thrust map uses it."""
        if self._config.thrust_map.battery_voltage == 0.0:
            return []

        def receive(message: Any, now_ns: int) -> None:
            self._receive_voltage(float(getattr(message, field)), now_ns)

        return [Subscription(topic=topic, receive=receive)]

    def _receive_voltage(self, voltage: float, now_ns: int) -> None:
        """Receive a battery voltage [V] as reported by the stack, valid or not."""
        warning = self.thrust.receive_voltage(voltage, now_ns=now_ns)
        self._warnings += [warning] if warning else []

    def _command_fault(self, command: CommandSample, now_ns: int) -> str | None:
        if not all(map(math.isfinite, (command.throttle, *command.w_WB_B.tolist()))):
            return "the command is not finite"
        if not 0.0 <= command.throttle <= 1.0:
            return f"the command's throttle {command.throttle:.3g} is outside [0, 1]"
        fastest = max(map(abs, command.w_WB_B.tolist()))
        if fastest > _MAX_BODY_RATE:
            return f"the command's body rate {fastest:.3g} rad/s exceeds {_MAX_BODY_RATE:g} rad/s"
        age = (now_ns - command.stamp_ns) * 1e-9
        if abs(age) > _COMMAND_TIMEOUT:
            return f"the command is {age:.3f} s old by its stamp"
        return None


def command_result(number: int) -> str:
    """Return a MAV_RESULT as text; PX4 and MAVROS use the same numbers."""
    return _MAV_RESULTS[number] if 0 <= number < len(_MAV_RESULTS) else f"result {number}"


class SwitchedBridge(Bridge):
    """A bridge to a stack without modes, which executes every setpoint, armed or not."""

    def _stack(self, now_ns: int) -> Stack:
        return Stack(takes_setpoints=True, armed=True)

    def _update_ground(self, odometry: OdometrySample, now_ns: int) -> None:
        """Do nothing: the ground state is unknown."""
