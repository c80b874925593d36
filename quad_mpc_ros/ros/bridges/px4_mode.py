# Copyright 2026 quad_mpc_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The flight mode of the MPC in PX4: registration, arming check, format of the messages.

PX4 lists a registered mode in the ground station and asks it every 0.3 s whether it can arm and
run. PX4 flies back (Return) if the answer is no, or if four answers are missing. PX4 registers a
mode only while disarmed and forgets it when it restarts. Messages exist since PX4 1.15:
https://docs.px4.io/main/en/ros2/px4_ros2_control_interface.html.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any

from quad_mpc_ros.messages.conversions import NewMessage
from quad_mpc_ros.messages.topics import Topic
from quad_mpc_ros.ros.bridges.bridge import Outgoing, OutgoingMessage, Subscription

MODE_NAME = "quad MPC"
API_VERSION = 1
"""``px4_ros2_api_version``, the version of the protocol."""
UNRESPONSIVE, DENIED = "check_external_modes_unresponsive", "check_system_arm_auth_failed"
"""Names of events of PX4: "Mode is unresponsive" and "Arm authorization denied"."""

_FIRST_STATE, _FIRST_SUB_MODE = 23, 11  # of external modes
_AUTO = 4.0  # custom main mode
_RETRY_NS = 2_000_000_000
_CRITICAL = 2 << 4 | 2  # log level of an event, internal and external
# Messages whose format is compared. Not those with char, which ROS cannot tell from uint8.
_COMPARED = (
    *("VehicleOdometry", "VehicleStatus", "VehicleControlMode", "VehicleLandDetected"),
    *("VehicleRatesSetpoint", "VehicleCommand", "VehicleCommandAck"),
    *("ArmingCheckRequest", "ArmingCheckReply"),
)
_PRIMITIVES = {"boolean": "bool", "float": "float32", "double": "float64", "octet": "byte"}


class Px4Mode:
    """The registration of the mode. ``outgoing`` collects the messages to send."""

    def __init__(
        self,
        new: NewMessage,
        topic: Callable[[str, str], Topic],
        *,
        check: Callable[[int], tuple[str, str]],
    ) -> None:
        """Initialise with functions of the bridge.

        Args:
            new: Creates empty messages by type name.
            topic: Returns a topic for a path and a message name.
            check: Returns why the mode cannot run at a time [ns], or an empty string, and the
                event that shows it.
        """
        self.state: int | None = None
        """PX4's ``nav_state`` of the mode, None until it is registered."""
        self.outgoing: list[Outgoing] = []
        self._new, self._check = new, check
        self._check_id = self._asked_id = 0
        self._requested_ns: int | None = None  # also the id of the request
        self._refusal, self._is_supported = "", True  # by PX4
        self._compared: dict[str, bool] = {}
        reply = topic("out/register_ext_component_reply", "RegisterExtComponentReply")
        asked = topic("out/arming_check_request", "ArmingCheckRequest")
        form = topic("out/message_format_response", "MessageFormatResponse")
        self.subscriptions = [
            Subscription(topic=reply, receive=self._on_registered),
            Subscription(topic=asked, receive=self._on_asked),
            Subscription(topic=form, receive=self._on_format),
        ]
        self._register = topic("in/register_ext_component_request", "RegisterExtComponentRequest")
        self._unregister = topic("in/unregister_ext_component", "UnregisterExtComponent")
        self._answer = topic("in/arming_check_reply", "ArmingCheckReply")
        self._setpoints = topic("in/config_control_setpoints", "VehicleControlMode")
        self._completed = topic("in/mode_completed", "ModeCompleted")
        self._format = topic("in/message_format_request", "MessageFormatRequest")
        self.publications = (
            *(self._register, self._unregister, self._answer),
            *(self._setpoints, self._completed, self._format),
        )

    @property
    def fault(self) -> str:
        """The reason why the mode cannot be selected in PX4, or an empty string."""
        wrong = [kind for kind, same in self._compared.items() if not same]
        if wrong:
            names = ", ".join(wrong)
            return f"px4_msgs is not of the vehicle's PX4 release, which differs in {names}"
        unregistered = f"PX4 has not registered the mode {MODE_NAME}, which needs PX4 1.15 to 1.17"
        return "" if self.state is not None else self._refusal or unregistered

    @property
    def parameters(self) -> tuple[float, float, float]:
        """The parameters of DO_SET_MODE that select the mode."""
        assert self.state is not None
        return 1.0, _AUTO, float(self.state - _FIRST_STATE + _FIRST_SUB_MODE)

    def awaits_removal(self, status: Any) -> bool:
        """Whether PX4 keeps the mode of a process that was killed, because it is still selected.

        PX4 would give a second mode of this name another place, and refuse to arm in the first.
        """
        selected = status.nav_state_user_intention
        is_external = selected >= _FIRST_STATE and status.can_set_nav_states_mask >> selected & 1
        return bool(self.state is None and is_external and not status.pre_flight_checks_pass)

    def follow(self, status: Any, *, armed: bool, now_ns: int) -> None:
        """Register again after PX4 or the bridge has restarted; ``status`` is PX4's."""
        waits = self._requested_ns is not None and abs(now_ns - self._requested_ns) < _RETRY_NS
        if waits or not self._is_supported:
            return  # the status may be older than the registration
        if self.state is not None and not status.can_set_nav_states_mask >> self.state & 1:
            self.state = None
        if self.state is None and not armed:
            self._requested_ns = now_ns
            self._compare_next()
            self._send(
                self._register,
                request_id=now_ns,
                name=_text(MODE_NAME, 25),
                px4_ros2_api_version=API_VERSION,
                register_arming_check=True,
                register_mode=True,
            )

    def configure(self) -> None:
        """Request body rates with thrust as the only setpoints, and stick override as offboard."""
        self._send(
            self._setpoints,
            source_id=self.state,
            flag_control_offboard_enabled=True,
            flag_control_rates_enabled=True,
            flag_control_allocation_enabled=True,
        )

    def report(self, now_ns: int) -> None:
        """Answer PX4's last arming check, again if the answer has changed."""
        blocker, event = self._check(now_ns)
        answer = self._send(
            self._answer,
            request_id=self._asked_id,
            registration_id=self._check_id,
            can_arm_and_run=not blocker,
            num_events=1 if blocker else 0,
            mode_req_angular_velocity=True,
            mode_req_attitude=True,
            mode_req_local_position=True,
        )
        if blocker:
            shown = answer.events[0]
            shown.id, shown.log_levels = 1 << 24 | fnv1a(event) & 0xFFFFFF, _CRITICAL

    def complete(self) -> None:
        """Tell a mode executor that the flight has ended."""
        self._send(self._completed, result=0, nav_state=self.state)

    def leave(self) -> None:
        """Remove the mode from PX4's list, at the end of the process."""
        if self.state is not None:
            ids = {"arming_check_id": self._check_id, "mode_id": self.state}
            self._send(self._unregister, name=_text(MODE_NAME, 25), mode_executor_id=-1, **ids)
            self.state = None

    def _on_registered(self, reply: Any, now_ns: int) -> None:
        ours = (self._requested_ns, list(_text(MODE_NAME, 25)))
        if (int(reply.request_id), list(reply.name)) != ours or self.state is not None:
            return
        if not reply.success:
            self._refusal = f"PX4 refuses to register the mode {MODE_NAME}: no free place"
        elif reply.px4_ros2_api_version != API_VERSION:
            self._is_supported = False
            self._refusal = (
                f"PX4 registers modes by version {reply.px4_ros2_api_version} of its protocol, "
                f"expected {API_VERSION}, which PX4 1.15 to 1.17 have"
            )
        else:
            self.state, self._check_id = int(reply.mode_id), int(reply.arming_check_id)
            self.configure()

    def _on_asked(self, request: Any, now_ns: int) -> None:
        self._asked_id = int(request.request_id)
        if self.state is not None:
            self.report(now_ns)

    def _compare_next(self) -> None:
        """Ask PX4 for the format of the next message."""
        rest = [kind for kind in _COMPARED if kind not in self._compared]
        if rest:
            name = _text(_topic_name(rest[0]), 50)
            self._send(self._format, protocol_version=1, topic_name=name)

    def _on_format(self, response: Any, now_ns: int) -> None:
        name = bytes(response.topic_name).rstrip(b"\0").decode(errors="replace")
        for kind in _COMPARED:
            if _topic_name(kind) == name and kind not in self._compared:
                ours = fnv1a("".join(_fields(kind, self._new)))
                self._compared[kind] = bool(response.success) and response.message_hash == ours
                self._compare_next()

    def _send(self, topic: Topic, **fields: object) -> Any:
        message = self._new(topic.type_name)
        for field, value in fields.items():
            setattr(message, field, value)
        self.outgoing.append(OutgoingMessage(topic=topic, message=message))
        return message


def fnv1a(text: str) -> int:
    """Return the 32 bit FNV-1a hash, by which PX4 numbers events and message formats."""
    value = 0x811C9DC5
    for byte in text.encode():
        value = (value ^ byte) * 0x1000193 & 0xFFFFFFFF
    return value


def _fields(kind: str, new: NewMessage) -> Iterator[str]:
    """Yield type and name of each field as in a .msg file, nested messages included."""
    for name, of_type in type(new(f"px4_msgs/msg/{kind}")).get_fields_and_field_types().items():
        base, bracket, length = of_type.removeprefix("px4_msgs/").partition("[")
        yield f"{_PRIMITIVES.get(base, base)}{bracket}{length} {name}\n"
        if of_type.startswith("px4_msgs/"):
            yield from _fields(base, new)


def _topic_name(kind: str) -> str:
    return "/fmu/out/" + re.sub(r"(?<!^)(?=[A-Z])", "_", kind).lower()


def _text(text: str, length: int) -> list[int]:
    """Return a text as an array of char."""
    return [*text.encode().ljust(length, b"\0")]
