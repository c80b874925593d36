"""The contract of every bridge: the rules and messages of a flight stack.

A bridge turns the stack's state into odometry, and the MPC's command into the stack's messages.
It needs neither ROS nor a clock: it is given the time and a function that makes empty messages,
and it only reads and fills attributes. So the same object runs in a node, in a test and in a
simulation. Its file holds both halves: the codec, functions with frame and unit in their names,
and the rules, a subclass of :class:`Bridge`.

Every bridge obeys these rules:

- It sends only in answer to a fresh command. It has no timer: when the MPC falls silent the stack
  hears nothing more, no heartbeat either, and its own failsafe acts.
- It refuses, with a reason, what is not finite or not in a known frame.
- It passes on a reset of the estimator: same frame, next stamp, another position.
- It arms and switches modes only when asked to.
- It says whether the vehicle acts on commands. Otherwise the MPC learns nothing from them.
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from quad_mpc_ros.bridges.config import BridgeConfig
from quad_mpc_ros.bridges.odometry import OdometryStamps, PositionJumps
from quad_mpc_ros.bridges.thrust import ThrustMap
from quad_mpc_ros.messages.conversions import NewMessage
from quad_mpc_ros.messages.topics import Topic
from quad_mpc_ros.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.safety.validation import odometry_fault

_FASTEST_TURN = 100.0  # rad/s: more than the gyroscope of a vehicle can measure


@dataclass(frozen=True, kw_only=True)
class Subscription:
    """A topic of the stack and the function that takes its messages.

    ``receive`` gets a message and the time of its arrival [ns], and returns an odometry if there
    is one to pass on.
    """

    topic: Topic
    receive: Callable[[Any, int], OdometrySample | None]


@dataclass(frozen=True, kw_only=True)
class OutgoingMessage:
    """A filled message and the stack's topic that it goes to."""

    topic: Topic
    message: Any


@dataclass(frozen=True, kw_only=True)
class ServiceCall:
    """A filled request and the stack's service that it goes to.

    ``type_name`` is like ``std_srvs/srv/SetBool``.
    """

    service: str
    type_name: str
    request: Any


@dataclass(frozen=True, kw_only=True)
class Response:
    """The response to a request to arm or to engage, and what is to be sent for it.

    A refusal gives its reason in ``text``.
    """

    accepted: bool
    text: str
    messages: Sequence[OutgoingMessage] = ()
    calls: Sequence[ServiceCall] = ()


class Bridge(ABC):
    """Base of every bridge. Messages are sent in the order in which they are returned."""

    name: ClassVar[str]
    """The executable, which is also the node: ``px4_bridge``."""
    speaks: ClassVar[str]
    """The stack and its messages, in a few words."""
    packages: ClassVar[tuple[str, ...]]
    """The message packages that it needs."""
    how_to_get: ClassVar[str]
    """How to install them when they are missing."""
    Config: ClassVar[type[BridgeConfig]]

    subscriptions: Sequence[Subscription]
    """What the bridge listens to."""
    publications: Sequence[Topic]
    """What the bridge may publish."""
    services: Sequence[tuple[str, str]] = ()
    """The services that the bridge may call: name and type."""

    @classmethod
    def main(cls, args: list[str] | None = None) -> int:
        """Run the node around this bridge and return its exit code: what the executable calls."""
        from quad_mpc_ros.bridges.node import run_bridge  # a bridge itself needs no ROS

        return run_bridge(cls, args)

    def __init__(self, config: Any, new: NewMessage, *, namespace: str = "") -> None:
        """A bridge of one's own also sets ``subscriptions`` and ``publications``.

        Args:
            config: An instance of ``Config``.
            new: Makes empty messages, and empty requests of services.
            namespace: Of the stack's topics and services.
        """
        self.thrust = ThrustMap(config)
        self.silence = "waiting for a command"
        self.commands = self.passed = self.refused = 0
        self._new = new
        self._config = config
        self._namespace = namespace
        self._stamps = OdometryStamps(tolerance=config.clock_tolerance)
        self._jumps = PositionJumps()
        self._warnings: list[str] = []

    @abstractmethod
    def arm(self, wanted: bool, *, now_ns: int) -> Response:
        """Arm or disarm, because somebody asked for it."""

    @abstractmethod
    def engage(self, wanted: bool, *, now_ns: int) -> Response:
        """Hand the vehicle to the MPC, or take it away, because somebody asked for it."""

    @abstractmethod
    def _reason_for_silence(self, now_ns: int) -> str | None:
        """Return why nothing must be sent to the stack now, or None."""

    def _acts(self, now_ns: int) -> bool:
        """Return whether the vehicle acts on setpoints, as far as the stack tells."""
        return True

    @abstractmethod
    def _messages(self, command: CommandSample, now_ns: int) -> list[OutgoingMessage]:
        """Return what is to be sent to the stack for a fresh command."""

    def receive_command(self, command: CommandSample, *, now_ns: int) -> list[OutgoingMessage]:
        """Return what is to be sent for a command that arrives now, which may be nothing.

        Afterwards ``silence`` says why nothing was sent, or is empty.
        """
        self.commands += 1
        fault = self._command_fault(command, now_ns) or self._reason_for_silence(now_ns)
        if fault is not None:
            self.silence = fault
            return []
        self.silence = ""
        self.passed += 1
        return self._messages(command, now_ns)

    def engaged(self, *, now_ns: int) -> bool:
        """Return whether the vehicle acts on commands: armed, in the mode that takes them."""
        return self._reason_for_silence(now_ns) is None and self._acts(now_ns)

    @property
    def jumps(self) -> int:
        """How often the estimated position jumped."""
        return self._jumps.count

    def take_warnings(self) -> list[str]:
        """Return the warnings since the last call."""
        warnings, self._warnings = self._warnings, []
        return warnings

    def _topic(self, path: str, type_name: str, **quality: Any) -> Topic:
        """Return a topic in the stack's namespace; ``quality`` is what else a topic takes."""
        return Topic(name=f"{self._namespace}/{path}", type_name=type_name, **quality)

    def _service(self, path: str, type_name: str) -> tuple[str, str]:
        """Return name and type of a service in the stack's namespace."""
        return f"{self._namespace}/{path}", type_name

    def _call(self, service: tuple[str, str], **fields: object) -> ServiceCall:
        """Return a call with these fields in its request."""
        name, type_name = service
        request = self._new(type_name)
        for field, value in fields.items():
            setattr(request, field, value)
        return ServiceCall(service=name, type_name=type_name, request=request)

    def _converted(
        self, source: str, convert: Callable[[], OdometrySample | None]
    ) -> OdometrySample | None:
        """Return an odometry, or note why there is none: the conversion raises ``ValueError``."""
        try:
            return convert()
        except ValueError as error:
            self._refuse(f"{source}: {error}")
            return None

    def _passed_on(
        self, odometry: OdometrySample | None, *, now_ns: int, cause: str | None = None
    ) -> OdometrySample | None:
        """Return an odometry, if there is one, with the stamp and the frames that the MPC wants.

        Returns None, and notes why, if it is not valid or not newer than the last.
        """
        if odometry is None:
            return None
        odometry = dataclasses.replace(
            odometry,
            frame_id=self._config.frame_id,
            child_frame_id=self._config.child_frame_id,
        )
        # As the MPC judges it; the stamp comes after.
        fault = odometry_fault(odometry, frame_id=odometry.frame_id)
        if fault is not None:
            self._refuse(f"the stack's state is not valid: {fault}")
            return None
        stamp_ns = self._stamps.stamp(odometry.stamp_ns, now_ns=now_ns)
        if stamp_ns is None:
            self.refused += 1
            return None
        odometry = dataclasses.replace(odometry, stamp_ns=stamp_ns)
        warning = self._jumps.check(odometry, cause=cause)
        if warning is not None:
            self._warnings.append(warning)
        return odometry

    def _refuse(self, reason: str) -> None:
        self.refused += 1
        self._warnings.append(reason)

    def _battery_subscription(self, topic: Topic, *, field: str = "voltage") -> list[Subscription]:
        """Return the subscription to the battery's voltage, if the thrust map uses it."""
        if self._config.thrust_map.battery_voltage == 0.0:
            return []

        def receive(message: Any, now_ns: int) -> None:
            self.thrust.receive_voltage(float(getattr(message, field)), now_ns=now_ns)

        return [Subscription(topic=topic, receive=receive)]

    def _command_fault(self, command: CommandSample, now_ns: int) -> str | None:
        if not all(map(math.isfinite, (command.throttle, *command.w_WB_B.tolist()))):
            return "the command is not finite"
        if not 0.0 <= command.throttle <= 1.0:
            return f"the command's throttle {command.throttle:.3g} is outside [0, 1]"
        fastest = max(map(abs, command.w_WB_B.tolist()))
        if fastest > _FASTEST_TURN:
            return f"the command's body rate {fastest:.3g} rad/s is beyond {_FASTEST_TURN:g} rad/s"
        age = (now_ns - command.stamp_ns) * 1e-9
        if abs(age) > self._config.command_timeout:
            return f"the command is {age:.3f} s old, by its stamp"
        return None


class SwitchedBridge(Bridge):
    """A bridge to a stack without modes: it sends nothing until it was asked to engage."""

    _engaged = False

    def engage(self, wanted: bool, *, now_ns: int) -> Response:
        """Let commands through, or no longer."""
        self._engaged = wanted
        return Response(accepted=True, text="engaged" if wanted else "released")

    def _reason_for_silence(self, now_ns: int) -> str | None:
        return None if self._engaged else "not engaged: call the service engage"
