"""The contract of every bridge: a stack's rules and messages, without ROS and without a clock.

A bridge turns the stack's state into odometry and the MPC's command into the stack's messages. It
is told the time and given a way to make empty messages; it reads attributes and fills messages,
and imports no message package. So the same object runs in a node, in a test and in a simulation.

What every bridge obeys:

- It speaks only in answer to a fresh command. It has no timer, so when the MPC falls silent the
  stack hears nothing more, no heartbeat either, and its own failsafe acts.
- What is not finite or not in a frame it knows is refused with a reason.
- A reset of the estimator is passed on: the same frame, the next stamp, another position.
- It arms and switches modes only when it is asked to.
- It says whether the vehicle acts on commands, from which the MPC learns.
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from quad_mpc_ros.bridges.config import BridgeConfig
from quad_mpc_ros.bridges.jumps import PositionJumps
from quad_mpc_ros.bridges.stamps import OdometryStamps
from quad_mpc_ros.bridges.thrust import ThrustMap
from quad_mpc_ros.messages.conversions import NewMessage
from quad_mpc_ros.messages.topics import Topic
from quad_mpc_ros.model.samples import CommandSample, OdometrySample
from quad_mpc_ros.safety.validation import odometry_fault

_FASTEST_TURN = 100.0  # rad/s, which no gyroscope of a vehicle measures


@dataclass(frozen=True, kw_only=True)
class Subscription:
    """A topic of the stack, and what takes its message and the time of its arrival [ns].

    ``receive`` returns an odometry when there is one to pass on.
    """

    topic: Topic
    receive: Callable[[Any, int], OdometrySample | None]


@dataclass(frozen=True, kw_only=True)
class Sending:
    """A filled message for a topic of the stack."""

    topic: Topic
    message: Any


@dataclass(frozen=True, kw_only=True)
class Call:
    """A filled request for a service of the stack; ``type_name`` like ``std_srvs/srv/SetBool``."""

    service: str
    type_name: str
    request: Any


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What became of a wish to arm or to engage: refused with a reason, or sent on."""

    accepted: bool
    text: str
    sendings: Sequence[Sending] = ()
    calls: Sequence[Call] = ()


class Bridge(ABC):
    """Base of every bridge. Messages are sent in the order in which they are returned."""

    name: ClassVar[str]
    """The executable, which is also the node: ``px4_bridge``."""
    speaks: ClassVar[str]
    """The stack and its messages, in a few words."""
    packages: ClassVar[tuple[str, ...]]
    """The message packages that it needs."""
    how_to_get: ClassVar[str]
    """How to get them when they are missing."""
    Config: ClassVar[type[BridgeConfig]]

    def __init__(self, config: Any, new: NewMessage) -> None:
        self.thrust = ThrustMap(config)
        self.silence = "waiting for a command"
        self.commands = self.passed = self.refused = 0
        self._new = new
        self._config = config
        self._stamps = OdometryStamps(tolerance=config.clock_tolerance)
        self._jumps = PositionJumps()
        self._warnings: list[str] = []

    @property
    @abstractmethod
    def subscriptions(self) -> Sequence[Subscription]:
        """What the bridge listens to."""

    @property
    @abstractmethod
    def publications(self) -> Sequence[Topic]:
        """What the bridge may publish."""

    @property
    def services(self) -> Sequence[tuple[str, str]]:
        """The services that the bridge may call: name and type."""
        return ()

    @abstractmethod
    def arm(self, wanted: bool, *, now_ns: int) -> Answer:
        """Arm or disarm, because somebody asked for it."""

    @abstractmethod
    def engage(self, wanted: bool, *, now_ns: int) -> Answer:
        """Hand the vehicle to the MPC, or take it away, because somebody asked for it."""

    @abstractmethod
    def _reason_for_silence(self, now_ns: int) -> str | None:
        """Return why the stack must hear nothing now, or None."""

    def _acts(self, now_ns: int) -> bool:
        """Return whether the vehicle acts on what it hears, as far as the stack tells."""
        return True

    @abstractmethod
    def _messages(self, command: CommandSample, now_ns: int) -> list[Sending]:
        """Return what the stack is to hear of a fresh command."""

    def receive_command(self, command: CommandSample, *, now_ns: int) -> list[Sending]:
        """Return what is to be sent for a command that arrives now: nothing when it must not."""
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
        """How often the estimated position stepped."""
        return self._jumps.count

    def take_warnings(self) -> list[str]:
        """Return what there is to tell the log since the last call."""
        warnings, self._warnings = self._warnings, []
        return warnings

    def _passed_on(
        self, odometry: OdometrySample, *, now_ns: int, cause: str | None = None
    ) -> OdometrySample | None:
        """Return an odometry stamped and named for the MPC, or None with the reason told."""
        odometry = dataclasses.replace(
            odometry,
            frame_id=self._config.frame_id,
            child_frame_id=self._config.child_frame_id,
        )
        # What the MPC would refuse; its stamp is another matter.
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
